"""The blind trial: hidden physics with sealed answers, on the user's own profile."""
