"""Diagnosis of drive logs: what the encoders, the gyro and the truth disagree about.

`engine.diagnose_drive` reads in this order: ``series`` (the log row by row) with its ``rests``, ``checks`` (mix-ups
of units and signs), ``laws`` (what each law adds to encoder turn minus gyro turn), ``levels`` (what a law must gain,
and how improbable a pattern must be), ``yaw`` (the noise of that difference), ``weighing`` (what laws gain under it),
``prior`` (what is known before), ``motions`` (of a bias that comes with them) and ``jumps`` (of one at an instant),
``wheels`` (one out of true), ``nameless`` (what no law makes), ``lasting`` (what speaks against a name),
``alignment``, ``asked`` (what a log may hold at one delay) and ``search`` (which laws it holds), ``reckoning`` (the
path), ``path_gaps`` (what a gap hides of it), ``path_noise``, ``path_strangers``, ``path_problem`` (one linearisation
of it), ``path_laid`` (Gauss and Newton over it) and ``truth`` (the path against true positions), ``beside_truth``
(laws that it denies or adds), ``sides`` (left turns against right), ``findings`` (names) and ``places`` (where),
``heldout`` (their worth on parts left out), ``filed`` and ``improved`` (the given robot file and the one that is
written), ``estimates`` (every figure, and what it costs), ``visible`` (what the noise of the truth hides of a gain).
"""
