/* The same extended Kalman filter of the rigid short period, by hand: eight states, two outputs, Joseph's update, one record after the other. */
#include <math.h>
#include <string.h>

#define N 8

static void rates(const double *scale, const double *x, double u, double *rate) {
    double hat = scale[2] * x[1];
    rate[0] = x[1] - scale[0] * (x[2] * x[0] + x[3] * hat + x[4] * u);
    rate[1] = scale[1] * (x[5] * x[0] + x[6] * hat + x[7] * u);
}

static void predict(const double *scale, double dt, double u, double *x, double P[N][N]) {
    double lift = scale[0], moment = scale[1], hat = scale[2];
    double F[2][N] = {{-lift * x[2] * dt, (1.0 - lift * hat * x[3]) * dt, -lift * x[0] * dt, -lift * hat * x[1] * dt, -lift * u * dt, 0, 0, 0},
                      {moment * x[5] * dt, moment * hat * x[6] * dt, 0, 0, 0, moment * x[0] * dt, moment * hat * x[1] * dt, moment * u * dt}};
    double Phi[2][N], top[2][N], y[N], k1[2], k2[2], k3[2], k4[2];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < N; j++) Phi[i][j] = (i == j) + F[i][j] + 0.5 * (F[i][0] * F[0][j] + F[i][1] * F[1][j]);
    /* Below its first two rows Phi is the identity. */
    memset(top, 0, sizeof top);
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < N; k++)
            for (int j = 0; j < N; j++) top[i][j] += Phi[i][k] * P[k][j];
    for (int i = 0; i < 2; i++) {
        for (int j = 2; j < N; j++) P[i][j] = P[j][i] = top[i][j];
        for (int j = 0; j < 2; j++) {
            double sum = 0.0;
            for (int k = 0; k < N; k++) sum += top[i][k] * Phi[j][k];
            y[i * 2 + j] = sum;
        }
    }
    P[0][0] = y[0], P[1][1] = y[3], P[0][1] = P[1][0] = 0.5 * (y[1] + y[2]);
    memcpy(y, x, sizeof y);
    rates(scale, y, u, k1);
    for (int i = 0; i < 2; i++) y[i] = x[i] + 0.5 * dt * k1[i];
    rates(scale, y, u, k2);
    for (int i = 0; i < 2; i++) y[i] = x[i] + 0.5 * dt * k2[i];
    rates(scale, y, u, k3);
    for (int i = 0; i < 2; i++) y[i] = x[i] + dt * k3[i];
    rates(scale, y, u, k4);
    for (int i = 0; i < 2; i++) x[i] += dt / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
}

static double update(const double *R, const double *z, double *x, double P[N][N]) {
    double S00 = P[0][0] + R[0], S01 = P[0][1], S11 = P[1][1] + R[1], det = S00 * S11 - S01 * S01;
    double I00 = S11 / det, I01 = -S01 / det, I11 = S00 / det, y0 = z[0] - x[0], y1 = z[1] - x[1];
    double K0[N], K1[N], A[N][N];
    for (int i = 0; i < N; i++) {
        K0[i] = P[i][0] * I00 + P[i][1] * I01;
        K1[i] = P[i][0] * I01 + P[i][1] * I11;
    }
    for (int i = 0; i < N; i++) x[i] += K0[i] * y0 + K1[i] * y1;
    /* (I - K H) P (I - K H)' + K R K', H the first two rows of the identity. */
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) A[i][j] = P[i][j] - K0[i] * P[0][j] - K1[i] * P[1][j];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) P[i][j] = A[i][j] - A[i][0] * K0[j] - A[i][1] * K1[j] + K0[i] * R[0] * K0[j] + K1[i] * R[1] * K1[j];
    return -0.5 * (y0 * (I00 * y0 + I01 * y1) + y1 * (I01 * y0 + I11 * y1) + log(det)) - 1.8378770664093453;
}

/* z is (runs, samples, 2), mean and variance (runs, 8), total (runs). */
void filter_runs(int runs, int samples, double dt, const double *scale, const double *u, const double *z, const double *R,
                 const double *start, const double *start_variance, double *mean, double *variance, double *total) {
    for (int r = 0; r < runs; r++) {
        double x[N], P[N][N] = {{0}}, sum;
        const double *measured = z + (size_t)r * samples * 2;
        memcpy(x, start, sizeof x);
        for (int i = 0; i < N; i++) P[i][i] = start_variance[i];
        sum = update(R, measured, x, P);
        for (int k = 1; k < samples; k++) {
            predict(scale, dt, u[k - 1], x, P);
            sum += update(R, measured + 2 * k, x, P);
        }
        memcpy(mean + (size_t)r * N, x, sizeof x);
        for (int i = 0; i < N; i++) variance[(size_t)r * N + i] = P[i][i];
        total[r] = sum;
    }
}
