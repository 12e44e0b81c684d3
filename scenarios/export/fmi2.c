/* Written by flightid export: FMI 2.0 co-simulation, SI and radians. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/*CONSTANTS*/

static double interpolate(double x, const double *knots, const double *values, int n)
{
    int i = 0;
    if (x <= knots[0]) return values[0];
    if (x >= knots[n - 1]) return values[n - 1];
    while (i < n - 2 && x >= knots[i + 1]) ++i;
    return values[i] + (x - knots[i]) / (knots[i + 1] - knots[i]) * (values[i + 1] - values[i]);
}

/*FUNCTIONS*/

typedef struct { double t, x[NX], v[NV]; int started; } Unit;
typedef void *Component;
typedef int Status; /* 0 OK, 3 error */
typedef unsigned int Reference;

static void restart(Unit *c)
{
    memcpy(c->x, c->v, sizeof c->x);
}

static void read_outputs(Unit *c)
{
    readings(c->t, c->x, c->v + NX, c->v + NX + NU, c->v + NX + NU + NP);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT Component fmi2Instantiate(const char *name, int type, const char *guid, const char *place,
                                 const void *functions, int visible, int logging)
{
    Unit *c;
    (void)name; (void)place; (void)functions; (void)visible; (void)logging;
    if (type != 1 || guid == NULL || strcmp(guid, GUID) != 0) return NULL;
    c = calloc(1, sizeof *c);
    if (c == NULL) return NULL;
    memcpy(c->v, STARTS, sizeof c->v);
    restart(c);
    return c;
}

EXPORT void fmi2FreeInstance(Component c) { free(c); }

EXPORT Status fmi2SetupExperiment(Component component, int given, double tolerance, double start,
                                  int stops, double stop)
{
    (void)given; (void)tolerance; (void)stops; (void)stop;
    ((Unit *)component)->t = start;
    return 0;
}

EXPORT Status fmi2EnterInitializationMode(Component component) { (void)component; return 0; }

EXPORT Status fmi2ExitInitializationMode(Component component)
{
    Unit *c = component;
    restart(c);
    c->started = 1;
    return 0;
}

EXPORT Status fmi2Terminate(Component component) { (void)component; return 0; }

EXPORT Status fmi2Reset(Component component)
{
    Unit *c = component;
    memset(c, 0, sizeof *c);
    memcpy(c->v, STARTS, sizeof c->v);
    restart(c);
    return 0;
}

EXPORT Status fmi2SetReal(Component component, const Reference *which, size_t n,
                          const double *values)
{
    Unit *c = component;
    size_t i;
    for (i = 0; i < n; ++i) {
        if (which[i] >= NX + NU + NP) return 3;
        c->v[which[i]] = values[i];
    }
    if (!c->started) restart(c);
    return 0;
}

EXPORT Status fmi2GetReal(Component component, const Reference *which, size_t n, double *values)
{
    Unit *c = component;
    size_t i;
    read_outputs(c);
    for (i = 0; i < n; ++i) {
        if (which[i] >= NV) return 3;
        values[i] = c->v[which[i]];
    }
    return 0;
}

EXPORT Status fmi2DoStep(Component component, double now, double step, int keeps)
{
    Unit *c = component;
    const double *u = c->v + NX, *p = c->v + NX + NU;
    double k[4][NX], y[NX], dt;
    int i, j, steps = (int)ceil(step / MAX_STEP - 1e-9);
    (void)keeps;
    if (steps < 1) steps = 1;
    dt = step / steps;
    c->t = now;
    for (i = 0; i < steps; ++i) {
        rates(c->t, c->x, u, p, k[0]);
        for (j = 0; j < NX; ++j) y[j] = c->x[j] + dt / 2 * k[0][j];
        rates(c->t + dt / 2, y, u, p, k[1]);
        for (j = 0; j < NX; ++j) y[j] = c->x[j] + dt / 2 * k[1][j];
        rates(c->t + dt / 2, y, u, p, k[2]);
        for (j = 0; j < NX; ++j) y[j] = c->x[j] + dt * k[2][j];
        rates(c->t + dt, y, u, p, k[3]);
        for (j = 0; j < NX; ++j)
            c->x[j] += dt / 6 * (k[0][j] + 2 * k[1][j] + 2 * k[2][j] + k[3][j]);
        c->t = now + (i + 1) * dt;
    }
    for (j = 0; j < NX; ++j) if (!isfinite(c->x[j])) return 3;
    return 0;
}

EXPORT Status fmi2SetDebugLogging(Component c, int on, size_t n, const char *const *what)
{ (void)c; (void)on; (void)n; (void)what; return 0; }
EXPORT Status fmi2CancelStep(Component c) { (void)c; return 3; }
#define TYPED(TYPE, NAME) \
    EXPORT Status fmi2Get##NAME(Component c, const Reference *r, size_t n, TYPE *v) \
    { (void)c; (void)r; (void)v; return n ? 3 : 0; } \
    EXPORT Status fmi2Set##NAME(Component c, const Reference *r, size_t n, const TYPE *v) \
    { (void)c; (void)r; (void)v; return n ? 3 : 0; }
TYPED(int, Integer)
TYPED(int, Boolean)
TYPED(const char *, String)
EXPORT Status fmi2GetFMUstate(Component c, void **s) { (void)c; (void)s; return 3; }
EXPORT Status fmi2SetFMUstate(Component c, void *s) { (void)c; (void)s; return 3; }
EXPORT Status fmi2FreeFMUstate(Component c, void **s) { (void)c; (void)s; return 3; }
EXPORT Status fmi2SerializedFMUstateSize(Component c, void *s, size_t *n)
{ (void)c; (void)s; (void)n; return 3; }
EXPORT Status fmi2SerializeFMUstate(Component c, void *s, char b[], size_t n)
{ (void)c; (void)s; (void)b; (void)n; return 3; }
EXPORT Status fmi2DeSerializeFMUstate(Component c, const char b[], size_t n, void **s)
{ (void)c; (void)b; (void)n; (void)s; return 3; }
EXPORT Status fmi2GetDirectionalDerivative(Component c, const Reference *a, size_t m,
                                           const Reference *b, size_t n, const double *d, double *r)
{ (void)c; (void)a; (void)m; (void)b; (void)n; (void)d; (void)r; return 3; }
EXPORT Status fmi2SetRealInputDerivatives(Component c, const Reference *r, size_t n, const int *o,
                                          const double *v)
{ (void)c; (void)r; (void)n; (void)o; (void)v; return 3; }
EXPORT Status fmi2GetRealOutputDerivatives(Component c, const Reference *r, size_t n, const int *o,
                                           double *v)
{ (void)c; (void)r; (void)n; (void)o; (void)v; return 3; }
EXPORT Status fmi2GetStatus(Component c, int kind, Status *v)
{ (void)c; (void)kind; (void)v; return 3; }
EXPORT Status fmi2GetRealStatus(Component c, int kind, double *v)
{ (void)c; (void)kind; (void)v; return 3; }
EXPORT Status fmi2GetIntegerStatus(Component c, int kind, int *v)
{ (void)c; (void)kind; (void)v; return 3; }
EXPORT Status fmi2GetBooleanStatus(Component c, int kind, int *v)
{ (void)c; (void)kind; (void)v; return 3; }
EXPORT Status fmi2GetStringStatus(Component c, int kind, const char **v)
{ (void)c; (void)kind; (void)v; return 3; }
