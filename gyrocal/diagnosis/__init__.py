"""Locate the mismatch, name the physics left out, model it, show the fit improve.

``engine`` leads (`engine.diagnose`), and ``examine`` takes a recording apart; both go through the folders in this order:

======== ==================================================================================================
rows     the recording as rows with coordinates, and what is refused or said of it before anything is fitted
model    everything that a calibration may contain as one additive model, all variances at once
laws     the catalogue's laws at these rows, against each other and in place of parts of that model
sweeps   the same for a table of sweeps, where the coil's temperature and time are found jointly
names    which laws are named, and what else they may be
answer   what is said and written: effects, places, the staircase, the coefficient files
======== ==================================================================================================

``result`` (all that is answered, and its JSON) and ``remarks`` (what is said beside the numbers) are everybody's.

Words: a *part* is some columns with one variance, a *block* the parts that are kept or dropped together
(`model.parts.BLOCKS`), a *component* either of these or a random process, as the model takes it; a *law* is an effect of the
catalogue at some shape, in place of a block or beside it. What *stays* with the gyro goes into the file, what *passes*
(walks, drifts, noise, errors of the table) is fitted beside it. The *direction* is whether the surface is one of the output
or of the true rate. Evidence is in *nats*, differences of the log marginal likelihood.

``drive`` does the same for drive logs, ``versus`` for a recording against somebody's own simulation.
"""
