"""Locate the mismatch, name the physics left out, model it, show the fit improve.

How a recording goes through the room, file by file; `engine.diagnose` reads in this order.

Rows        ``series`` (a run as rows with coordinates), ``table_series`` (a table), ``nominal`` (the rates that were meant), ``order`` (of data sets, as a clock), ``history`` (the temperature
            behind its readings), ``columns`` (what a record gives the laws), ``base`` (what the surface alone predicts),
            ``inputs`` (what is refused or said), ``given`` (what a file that came along has already),
            ``scatter`` (bursts, steps, clocks and a dead or clipped gyro, that no mean shows), ``strays`` (data sets that are set aside).
Layers      ``examine`` leads: ``within`` (patterns inside data sets) and ``between`` (of the table angle, from one to the next), ``means`` (a row a data set),
            ``visited`` (temperatures and rates that it tells apart), ``parts`` (what a calibration may contain), ``settling`` (what a step response leaves in later rows), ``layers`` (all of it in one model, all variances at once),
            ``rate_errors`` (of which a few may be large), ``edges`` (over temperature, which look like what happens at an instant),
            ``blocks`` (which parts are there). A table of sweeps is searched jointly: ``coil`` with
            ``changes``, ``finer`` (shapes between those of a grid), ``candidates`` (what it found) and ``open_loop``.
Names       ``names`` leads: ``laws`` (the catalogue at these rows), ``contest`` (laws against each other),
            ``in_place`` (laws that stand for a block), ``misfit`` (what a law leaves that nearly holds), ``jumps`` (at an instant),
            ``estimates``, ``scan`` and ``intervals`` (parameters), ``lag_posterior`` (of a coil's lag), ``law_posterior`` (where a time constant scatters).
Answer      ``rounding`` (what output steps may have made), ``staircase`` (worth on data left out), ``surface`` (alone) and
            ``correction`` (with what stays, averaged over ``rivals`` of the laws, and with what passes as it is ``standing``; ``rising`` leaves out
            what no robot can undo), both as coefficient files, the latter weighed by ``fresh_run``;
            ``residual`` (what is left row by row), ``locate`` (where), ``at_rest`` (whether a bias follows the temperature alone), ``ways`` (whether the rest goes by how a rate was reached), ``answer`` and ``untimed`` (names as records), ``unclocked`` (what a table without times tells no robot).
Records     ``result`` (all that is answered, and its JSON), ``remarks`` (what is said beside the numbers).

Words: a *part* is some columns with one variance, a *block* the parts that are kept or dropped together (`parts.BLOCKS`), a
*component* either of these or a random process, as the model takes it; a *law* is an effect of the catalogue at some shape, in
place of a block or beside it. What *stays* with the gyro goes into the file, what *passes* (walks, drifts, noise, errors of the
table) is fitted beside it. The *direction* is whether the surface is one of the output or of the true rate. Evidence is in
*nats*, differences of the log marginal likelihood.

``drive`` does the same for drive logs, ``versus`` for a recording against somebody's own simulation.
"""
