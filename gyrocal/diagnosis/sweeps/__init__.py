"""Tables of sweeps: the coil's temperature, time, and what the bias remembers, found jointly.

``coil``            the search: a lag of the coil, laws of time and memory, smooth parts beside them
``changes``         the laws of time and of past temperatures and rates that it tries
``finer``           shapes between those of a grid
``candidates``      the models that were fitted, and those that a file is the mean of
``lag_posterior``   share and time constant of the lag over all that they may be
``law_posterior``   parameters of a law over all models that may be
``open_loop``       tables whose cubic in the rate may be a sine's
``strays``          data sets that say nothing of the surface
``unclocked``       what a table without times cannot tell a robot
"""
