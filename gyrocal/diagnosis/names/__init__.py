"""Which laws have a name.

``naming``   laws in place of smooth parts, block by block
``rivals``   what else they may be: models with another law in place of one
``between``  what follows the table angle from one data set to the next
``ways``     errors that go by the way on which a rate was reached, of which the catalogue has no law
"""
