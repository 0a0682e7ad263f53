"""Drive logs through the runtime: four conditions, alignment with truth, Monte Carlo."""
