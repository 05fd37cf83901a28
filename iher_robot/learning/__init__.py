"""The learner: hindsight replay, dynamics ensemble, imagination and DDPG.

It imports no driver and no task: it receives a goal model, array shapes and episodes.
"""
