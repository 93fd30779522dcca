"""What numba compiles: loops over samples, dynamics of a tree, scalar laws, the integrator's step and the sampling loop around it.

Everything is for one lane (one run), and the callers loop over lanes, or for eight of them side by side (`vectors.py`);
only the perturbation method advances all of them at once.
"""
