"""The numbers on which decisions of the loop depend, by the question that each answers, with its reason.

A reason is a theorem, a simulated null, or "chosen", and against what. The null of the whole loop is flown by
``tests/statistics/test_tracing_performance.py``, that of cross-validation by ``tests/statistics/test_partial_null.py``. What a user may
set is in ``settings``.
"""

from __future__ import annotations

# Is a residual noise? P-values of Ljung-Box's test, whose distribution under noise is fitted to simulated noise (``ident/statistics/residuals.py``).
COLOURED = 1e-3  # chosen: asked of a dozen sets a search, so that clean data rarely cost a further round
GROSSLY_COLOURED = 1e-20  # chosen: a rough fit carried to its end does not mend that
PROCESS_NOISE_OFFERED = 1e-2  # chosen: a gust fit is dear; clean innovations ask for it once in a hundred records
FEWEST_SAMPLES = 20  # chosen: with fewer the test has four lags at most, and little power
LOW_FREQUENCY = 4.0  # Hz. chosen: short periods and first elastic modes of piloted aircraft lie below

# Which samples are wrong? In robust sigmas.
SPIKE_WHILE_SEARCHING = 8.0  # chosen: before the model is complete a residual is not Gaussian; only what no motion explains goes
SPIKE_AT_THE_END = 5.5  # theorem: Gaussian noise exceeds it once in 3e7 samples
HEAVY_TAIL = (3.7, 6.5)  # theorem: Gaussian noise puts 2 of 10,000 samples there; more, by Poisson's law, is a heavy tail
HEAVY_TAIL_CHANCE = 1e-3  # p-value of that count
NEAR_EVENT = 0.15  # s. chosen: a few samples around the edge of a fitted event, where its form may be a little off

# What is worth a full fit?
COLLINEAR = 0.9  # chosen: signatures that share four fifths of their power explain each other
DISTINCT = 0.95  # chosen: places of one effect whose signatures are more alike are one start
HOPELESS_IN_SEARCH = 0.2  # of the best gain so far. chosen: a projected gain errs by less than a factor of five
HOPELESS_IN_REPLICATION = 0.1  # of the best projected gain. chosen: a lower bar than in the search, since colour makes a projected gain err by more
RIVAL = 0.5  # of the best gain. chosen: what brings less than half will not be the best of its size
CHEAP = 2  # parameters. chosen: such a candidate is fitted even if its projected gain is small, it costs little
MANY_CAUSES = 3  # chosen: so many at once are rare, and small ones put together imitate a cause that the library does not have
LOOKS_ALIKE = 0.5  # projected gain of a near-alias over what the effect itself brought. chosen, as RIVAL
LITTLE = 0.05  # of the best gain, or of all causes' together. chosen: below it a held-out change is not worth a fit, and an event among many is none
CANDIDATES_FITTED, GUARDS_FITTED = 6, 3  # chosen, for time: full fits to many subsets of the records are the dearest part
FOUND_IN_FULL = 2  # beyond those. chosen, for time: of what a fit shows and a projection does not, the best
GENERAL_FITTED, GENERAL_BESIDE = 4, 2  # instances of the general form fitted in full, alone and beside a named effect. chosen, for time
LEFT_FOR_GENERAL = 0.3  # of the means of a search, at least, which it gets back. chosen, for time
PAIRS_FITTED = 3  # chosen, for time
LEFT_FOR_ALIASES = 0.2  # of the means of a search, at least: a dozen fits. chosen, for time
LEFT_FOR_ROUND = 0.3  # of the means of a search, at least, in each round after the first. chosen, for time
LEFT_FOR_PAIRS = 0.3  # of the means of a search, at least. chosen, for time
PAIRS_AT_ONCE = 6  # of the search. chosen, for time: projections of two effects err more than of one
SINGLES_CROSSED, PAIRS_CROSSED = 6, 4  # sets of one effect screened for the others, pairs of them fitted. chosen, for time
PAIR_MARGIN = 0.01  # of ln(error). chosen: a pair's projection is not known better
EVENT_SHIFTS = (-0.6, -0.3, 0.3, 0.6)  # s. chosen: half a period of a short-period motion either way, in steps that the fit closes
EDGES_WIDENED = (16, 4)  # times. chosen: several samples wide, narrower than a short period; then down to their own width
ENDS_MOVED = ((0.1, 0.1), (0.1, 0.0), (0.0, 0.1), (-0.1, -0.1))  # of an event's length. chosen: half a sine fitted by 1 - cos ends a tenth too late
PLACES_OF_A_MODE = 2  # chosen: a peak over the frequencies tried, and the best place that is none
NEAR_ABSENCE = 0.01  # of a projected step. chosen: slopes hold there
SHORTER_STEPS = (0.3, 0.1, NEAR_ABSENCE)  # of a projected step that led astray, in turn. chosen, as a line search: thirds of the step before
RIVALS_NEAR, RIVALS_WIDE = 3, 6  # sets weighed again within ``near`` and ``wide``. chosen, for time
HALF_ITS_PRICE = 0.5  # chosen: a projected gain below half of what an addition costs is not worth a fit
BETTER_PLACE = 0.5  # of the cost. chosen: a fit that gains less has found the same optimum
OUTDONE = 2.0  # chosen: what any record may have waits for a steady cause of twice its gain, beside which it is offered again
INSTEAD_OF_MOTION = 3  # causes fitted in its place. chosen, for time
DWARFED = 10.0  # chosen: the same of a cause that could imitate slow motion
DOMINANT = 3.0  # chosen: process noise that brings three times the best cause's gain is no stand-in for that cause

# What does a gain count?
SAMPLES_THAT_MAY_DOMINATE = 3  # chosen: evidence must not depend on as many samples as a spike and its neighbours are

# Which of two sets is kept? Differences of twice the log likelihood.
GUARDS_COMPARED = 2  # on data that were not fitted. chosen, for time
GUARD_TIE = 12.0  # chosen: a guard has to win by more than an addition has to bring (``TraceSettings.accept``), and two more
AMBIGUOUS = 3.0  # chosen: odds of 4.5 to one; below it two names are equal
ALTERNATIVE = 10.0  # chosen: odds of 150 to one; below it the other is named as an alternative
DECLARED_DERIVATIVES = 0.3  # of each value, one sigma. fixed by the vehicle file, whose derivatives are possibly 30 % wrong
FEWEST_DECLARED = 3  # derivatives. chosen: a file that declares fewer knows no aircraft
BLURRED = 10.0  # chosen: a sigma that an addition makes ten times larger has lost what the record told
SHORTEST_EVENT = 2.0  # sampling intervals. chosen: no load or gust on an aircraft comes and goes within
GAP, EDGE_OF_A_GAP = 5.0, 3.0  # samples. chosen: shorter than any maneuver's pulse; an onset is known to a sample or two
STEPS, STEP_TAKES, AT_A_STEP = 0.5, 0.3, 2.0  # of an input's range; s; samples. chosen: both ends of one event in seventy lie so by chance
COINCIDENT = 0.025  # theorem: of two events with nothing in common one in twenty pairs begin within a fortieth of the span
ROWS_BEFORE = 10  # samples. chosen: the motion just before a jump, from few enough to be straight
AT_A_BOUND = 0.99  # chosen: a frequency this near to what the records resolve was held there
ALTERNATIVES_NAMED = 2  # fixed by the format of a diagnosis

# Does an effect lower the error on records that were not fitted? Mean over channels of ln(error).
WORTH = 0.1  # chosen: less is what a dozen small causes make; ``test_partial_null`` counts what passes all bars where nothing is hidden
HALF_OF_IT = 0.5  # chosen: what does not bring half of that on the fitted records will not bring it on others
SHOWS = 9.0  # squared change over the noise's power in data held out. theorem: three sigmas; of false effects of that size 1 % pass by chance
MOST_OF_IT = 0.75  # of what two records leave. Simulated papers: with less, what is half of the truth was claimed for what was neither
# chosen: rise of one channel's error that is tolerated, or half of what is gained in the mean, and of one record's; beyond twice its scatter
TOLERATED_RISE = 0.05
STRONGLY = 2.0  # times what is worth a claim. chosen: what the null makes in three records left out in turn rarely reaches it once
STRONG_WITNESS = 10.0  # log likelihood. chosen: twice what an addition has to bring, since the same samples speak
EVENTS_FITTED = 3  # to each record left out. chosen, for time
LONE_EVENT = 30.0  # log likelihood. Simulation: the best of all events in 5 records of which none has one, coloured by what no effect names
# Of what its record leaves. Simulation, records of 10 to 25 s: gusts beside a wrong model 0.39 to 0.52 (12), events that a wrong model made 0.05 to
# 0.44 (8): most of those gusts remain hints, which is the price of no false one.
EVENT_EXPLAINS = 0.5
STANDS_ALONE = 3.0  # chosen: what a wrong model has left differs less from record to record
BY_ONE_STEP = 30.0  # log likelihood. chosen, as ``LONE_EVENT``: one pair of effects in the place of another, where it predicts no worse
NO_PREFERENCE = 0.04  # chosen: no one would prefer one cause to another for four per cent of the error
BEYOND_ITS_SCATTER = 2.0  # theorem: two standard deviations, one in forty by chance
SAME_TRACE_SCATTER = 3.0  # standard deviations. chosen: of effects with one signature the data need more to prefer one
BLOCK = 1.5  # s. chosen: the residual of a short-period model hardly remembers itself beyond it
BEYOND_RANGE = 0.1  # of a curve's range. chosen: a curve is not judged where one record alone flew further
FEW_OTHER_SAMPLES = 0.01  # of all, set aside since. chosen: what replicates is weighed again without them, what does not is not looked for anew
DEEPEST = 2  # chosen: effects named where what remains is not noise; a third would rest on what two others left
WHOLE_REFIT_UP_TO = 3  # records. chosen: with more, one Gauss-Newton step from the common fit is near enough (a test compares them)

# Is it rough air? Asked of records that were not fitted, where what is left is not noise.
# Simulation: coloured noise of one channel or of all, each its own, -0.2 to 0.3; rough air by an independent simulator 0.7 to 1.1.
SHARE_OF_ANY_COLOUR = 0.35
EVEN = 1e-3  # theorem: p-value of Spearman's rank correlation; what a model of the forces lacks has 1e-5 and less on two records of 25 s
EPISODE = 0.65  # of the power in the loudest fifth of the time. Simulation: flights in rough air 0.26 to 0.52, one wake a record 0.72 to 0.98
FEWEST_SECONDS = 20  # chosen: with fewer the correlation could not reach that p-value unless it were complete

# Do records agree?
AGREE = 3.0  # theorem: corrected sigmas, one in 370 by chance
LEAST_SIGMA = 0.05  # of a value. chosen: no record's value weighs as if it were known better, since small causes differ between records
ALIKE = 0.4  # of the mean. chosen: two values that close are one value to anyone who uses them
MANY_RECORDS, STILL_MOST = 4, 0.5  # chosen: one of four or more may have a noisy value of its own; half the power is what is left to it
KNOWN = 0.5  # chosen: a record whose sigma is half the value does not tell it
OFF_ABSENCE = 2.0  # theorem: two sigmas, one in twenty by chance in a record
CLEARLY_OFF_ABSENCE = 4.0  # theorem: one in 16,000 by chance, since the best of many candidates is asked
FEWEST_RECORDS = 3  # chosen: two have one degree of freedom, which is no scatter to print and no ground to ask for replication first
# Simulation (``tests/unit/ident/tracing``, scatter between records): with six degrees of freedom from the other derivatives, two sigmas
# hold 93 to 98 of 100 with two to five records.
BORROWED = 6.0

# What does a residual go with?
WINDOW = 2.0  # s, in which a residual is called large. chosen: about one short period
SHIFT = 0.5  # s, by which a residual may follow or precede what it goes with. chosen: longer lags are another motion
WORTH_A_WORD = 0.25  # chosen: a smaller correlation explains less than a sixteenth of the power
SURE_OF_COMPANY = 4.0  # theorem: standard deviations of chance (Bartlett), the best of a few dozen signals being told

# How finely is it computed?
SLOPE_STEP = 1e-4  # of a parameter's declared size
COARSE = 0.025  # s, a sub-step that ranks candidates well enough
WORTH_A_FORK = 150_000  # samples of all outputs times candidates: two tenths of a second of screening, against hundredths for a fork
PLACES = 60  # over the record, for effects that may begin anywhere
AUTOREGRESSION = 12  # order: covers half a second at 25 Hz
BOOTSTRAP_DRAWS = 400  # a scatter is then known to 4 per cent

# How probable is a name? Calibrated on random cases and surrogate flights (``exam``), none of them of the reliability curve.
# By what a claim rests on, of its distance in twice the log likelihood; of what was cross-validated in scatters, squared, of 109 claims of
# surrogate flights, under which 0.3 was likeliest: resampled blocks are fewer than the samples that speak.
TEMPERATURE = {"noise left": 1.0, "cross-validated": 0.4, "one-step": 1.0, "samples": 1.0}
SHARE_OF_PRICE = 0.5  # of what the criterion charges
AGAINST_GUARDS = 0.0  # in twice the log likelihood
WRONG_WHATEVER = {"noise left": 0.03, "cross-validated": 0.03, "one-step": 0.03, "samples": 0.02}
# By what a claim rests on: it is likelier than all that is not named (theorem), and twice as likely where what remains is not noise (chosen).
LIKELY_BAR = {"noise left": 0.5, "cross-validated": 2.0 / 3.0, "one-step": 0.5, "samples": 0.5}
LIKELY_ENOUGH = 0.05  # fixed by the format of a diagnosis: what is likelier is named beside a claim
