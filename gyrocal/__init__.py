"""gyrocal: calibration bench for fiber-optic gyros.

Conventions, everywhere in this package
---------------------------------------
Units       SI, except deg/s, deg and degrees Celsius for the gyro. A public number carries its unit as a
            suffix: ``rate_dps``, ``temp_c``, ``bias_dph``, ``t_s``.
Signs       counter-clockwise seen from above is positive, for tables, gyros and robots.
Frames      robot: x forward, y left, heading counter-clockwise (REP 103).
Error       error = gyro output - true rate (paper eq. 1), so corrected = output - error.
Data set    the record at one rate and one temperature (paper section 2).
Noise       angle random walk N in deg/sqrt(h): the standard deviation of a mean over tau seconds is
            N / 60 / sqrt(tau) deg/s (IEEE 952).

Rooms       ``physics`` (catalogue of effects), ``fusion`` (runtime of a robot), ``records`` (files),
            ``bench`` (table, chamber, gyro), ``inference`` (noise, likelihoods, tests), ``calibration`` (fit),
            ``navigation`` (drive logs), ``diagnosis`` (missing physics), ``planning`` (the next experiment),
            ``trial`` (hidden physics with sealed answers), ``report`` (prose and pictures), ``commands`` (what the
            long ones run), ``cli`` (options and printing); beside them ``units``, ``errors``, ``extensions`` (what other packages add) and
            ``workers`` (processes).
            ``tests/test_architecture.py`` holds who may import whom.
"""

__version__ = "0.1.0"
