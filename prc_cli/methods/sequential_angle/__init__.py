"""Stamos et al. (2012): surfaces, ground, curbs and cars from angles along vertical scan lines."""
