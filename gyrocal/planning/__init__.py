"""The experiment that settles a doubt, from the bench's own planner and virtual world."""
