"""Estimators over whole recordings: ours, and those it is compared with, from one cell file."""
