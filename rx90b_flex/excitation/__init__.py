"""Excitations for identification: multisines, and trajectories designed for what they are to identify."""
