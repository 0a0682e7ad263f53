"""A recording as rows with coordinates: what everything after it is fitted to.

``series``        a run as rows with coordinates
``table_series``  a table of data sets as the same
``nominal``       the rates that were meant, where a table's readings scatter about them
``order``         the order of data sets as a clock, where there are no times
``history``       the temperature that the gyro went through, behind its readings
``columns``       conditions row by row for the laws, and the ranges that their shapes are tried in
``means``         one row for each data set, ramps and soaks in bins
``visited``       which temperatures and rates a record tells apart, and what it tells of the scale factor
``base``          what the error surface alone predicts
``inputs``        what is refused or said of a recording before it is examined
``scatter``       bursts, steps of the output, clocks, a dead or clipped gyro, which no mean shows
"""
