"""Imagined episodes: dynamics ensemble, rollouts, intrinsic reward."""
