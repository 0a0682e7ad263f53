"""What is said and written of a recording.

``effects``     named effects with parameters, rivals and evidence, and the verdict
``locate``      where the recording departs from the surface, and what is left
``residual``    what surface, laws and smooth parts leave of every row
``staircase``   what each layer is worth on data left out
``surface``     the surface alone, as a coefficient file
``correction``  that with everything that stays, averaged over the rivals
``between_rates``  what laws of the rate may do between the rates of the plan
``standing``    where bias and scale factor stand in the file, of what passes
``rising``      which shapes near zero rate a robot can undo
``fresh_run``   whether the file makes another run better than the surface alone does
``given``       what a file that came along explains already, and whether it holds
``at_rest``     whether a bias follows the temperature alone
``rounding``    what the steps of an output hide
``untimed``     times in data sets, for a table without any
"""
