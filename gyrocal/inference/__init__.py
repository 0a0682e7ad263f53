"""Noise and inference: arrays in, arrays out; used by fit, diagnosis, drives and report alike.

One statistic, the restricted likelihood of variances (Patterson, Thompson 1971), for each way to hold a covariance:

- `gls`: dense and known, with what is known of the amplitudes beforehand; a path laid on its truth;
- `scatter`: dense, three levels with their slopes and the posterior over them (`levels`); the data sets of `fit`;
- `additive`: a sum of many parts, most of few columns, in the space of error contrasts; layers of a recording;
- `whitening`: a state space that a Kalman filter goes through once, in linear time; samples of a run;
- `markov`: a banded precision, in linear time; nodes of a drive and their 1/f noise.

The variances of `additive` and `gls` are found by `newton`, from the slope and the average information of each.
"""
