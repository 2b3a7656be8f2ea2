"""What command line and Python interface have in common: requests, and what is made of them.

In: keys with values. Out: validated configurations of trainings, plans of evaluations, and what is
played, drawn and written of these.
"""
