"""The catalogue's laws at the rows of a recording.

``at_rows``    each law at the shapes that are tried, as columns
``scan``       how well a law does at any shape beside everything else
``contest``    laws against each other for what a block of smooth parts did
``in_place``   laws alone in place of a block: one, two of one effect, or several together
``jumps``      steps of bias and scale factor at an instant
``misfit``     what a law leaves where a gyro obeys it only nearly
``estimates``  parameters with intervals
"""
