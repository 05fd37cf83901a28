"""The learner: hindsight replay, dynamics ensemble, imagination and DDPG.

It knows no driver and no task: it receives a goal model, array shapes and episodes.
"""
