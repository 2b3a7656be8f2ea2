"""What command line and Python interface have in common: requests, and what is made of them.

In: keys with values. Out: validated configurations of trainings, and plans of evaluations.
"""
