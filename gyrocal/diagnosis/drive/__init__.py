"""Diagnosis of drive logs: what the encoders, the gyro and the truth disagree about.

`engine.diagnose_drive` leads. Of a log:

``series``           row by row: clean channels, rests, ticks, nodes of the comparison
``stamps``           rows that share a time
``rests``            when the robot stands, also by a speed that never reads zero
``checks``           units, signs and sides that are mixed up

The turn of the encoders less that of the gyro:

``laws``             what each law adds to it
``alignment``        by how much, and how blurred, the encoders are late
``asked``            what a log may hold once that is taken out
``yaw``              the noise beside all of it
``weighing``         what laws gain under that noise
``levels``           what a law must gain, and how improbable a pattern must be
``prior``            what the robot file knows beforehand
``search``           which laws the log holds
``motions``          a bias that comes with the motion
``jumps``            a bias that jumps
``wheels``           a wheel out of true
``nameless``         what no law makes
``lasting``          what speaks against a name: laws that do not last

The path against true positions:

``reckoning``        the path with errors taken out of it
``path_noise``       what noise does to it
``path_gaps``        what a gap hides of it
``path_problem``     one linearisation of it
``path_strangers``   columns without a name
``path_laid``        Gauss and Newton over it
``truth``            what the truth says of all figures
``beside_truth``     laws that it denies or adds
``sides``            left turns against right

The answer:

``findings``         names
``places``           where, when and in what the rest lives
``heldout``          what laws are worth on parts left out
``filed``            a robot file as figures
``improved``         the robot file that is written
``estimates``        every figure, and the metres that it costs
``visible``          what the noise of the truth hides of a gain
"""
