"""A recording against somebody's own simulation of it: what to add to that simulation.

``match``     recording and simulation set by set, their clocks, and the difference as a recording
``surfaces``  how far they are apart as bias and scale factor
``law``       the law between them, as far as the data show it
``answer``    the difference diagnosed, and whether its law helps on sets left out
``law_file``  the law as a Python file that needs numpy alone
``drive``     the same for a drive log and a simulated one
``between``   several recordings against one simulation: what differs between them
"""
