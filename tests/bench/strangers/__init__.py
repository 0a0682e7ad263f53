"""The other side: devices by another hand, written from manuals and protocol notes alone, and whole runs against them.

Nobody who wrote a file here had read the drivers or the virtual bench. A disagreement is a finding, not a nuisance.
"""
