"""All jobs in the order of the page."""

from benchmarks.comparison.job import Job
from benchmarks.jobs import closed_loop, flight, many_runs, output_error, single_filter, structure

JOBS: tuple[Job, ...] = (
    single_filter.PLAIN,
    single_filter.WITH_LIKELIHOODS,
    many_runs.JOB,
    output_error.JOB,
    structure.JOB,
    flight.JOB,
    closed_loop.JOB,
)
