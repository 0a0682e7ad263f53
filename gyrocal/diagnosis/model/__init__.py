"""Everything that a calibration may contain, in one additive model of the rows.

``parts``        the surface, smooth parts, and what passes, as columns and covariances
``layers``       all of it in one model, all variances at once by marginal likelihood
``blocks``       which parts are there, what each is worth, and which way the surface bends
``starts``       from where a fit of all of it starts, and what of it is alive
``rate_errors``  errors of single rates of which a few may be large
``edges``        edges over temperature, which look like what happens at an instant
``settling``     what an output that creeps after a step does to later rows
``within``       what lives inside data sets: patterns of the table angle, settling
``intervals``    one shape parameter at a time: refined, descended, and its interval from a profile
"""
