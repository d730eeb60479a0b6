"""A step of Gauss-Newton on the axis error of a motion, from footpoints to control points."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.banded import add_errors, add_path, axis_path, solve
from conflank_cli.geometry.kernels.motion_error import motion_errors

# Of the weight of a sample on the face: what a sample off it keeps, to hold the motion steady there.
OFF_FACE = 0.01
# Overcut is weighed up from this share of the tolerance on, so that the optimum stays inside it.
BARRIER_FROM, BARRIER_GAIN = 0.5, 40.0
# With fewer samples on the face than this a motion has left it.
LEAST_SAMPLES = 4
# A step that moves a control point by more is shortened to it, mm.
LONGEST_STEP = 1.0
# What a step may come to.
TAKEN, LOST, SINGULAR = 0, 1, 2


@njit(forceinline=True)
def robust_weight(error, over, scale, barrier):
    """Weight of an axis error or swept gap, mm, with a tolerance of overcut `over`.

    Stock left beyond `scale` fades (Geman and McClure): there another sweep does the work. Overcut counts in full and,
    with `barrier`, ever more as it nears its tolerance.
    """
    ratio = max(error, 0.0) / scale
    fading = 1.0 + ratio * ratio
    weight = 1.0 / (fading * fading)
    if barrier:
        excess = max(-error / over - BARRIER_FROM, 0.0)
        weight *= 1.0 + BARRIER_GAIN * excess * excess
    return weight


@njit(cache=True, nogil=True)
def robust_weights(errors, over, scale, barrier, weights):
    """`robust_weight` of each of errors (N,); fills weights (N,)."""
    for k in range(errors.shape[0]):
        weights[k] = robust_weight(errors[k], over, scale, barrier)


@njit(cache=True, nogil=True)
def sample_weights(error, on, over, scale, barrier, weight):
    """`robust_weight` of axis errors (m, n), next to nothing off the face, none without a footpoint; fills weight."""
    for i in range(error.shape[0]):
        for j in range(error.shape[1]):
            weight[i, j] = 0.0
            if on[i, j] > -0.5:
                share = 1.0 if on[i, j] > 0.5 else OFF_FACE
                weight[i, j] = share * robust_weight(error[i, j], over, scale, barrier)


@njit(cache=True, nogil=True)
def gauss_newton_step(
    breaks_u, breaks_v, coefficients, box, sense, raster, first, value, slope, bend, control, length, fractions, radii,
    u, v, warm, error, on, weights, fade, stiff, over, scale, barrier,
):  # fmt: skip
    """Move control points (n, 6), p and q of each, by a step; how that went, and what it promises of the functional.

    The first row of arguments is the face as in `motion_errors`, the next the basis (m,), (m, 4) at the sampled times.
    fractions, radii, u, v, warm, error, on: as there. weights (5,): mu1 to mu5. fade: factor on mu2 and mu5; stiff: on
    mu4. over, scale, barrier: as in `robust_weight`.
    """
    m = first.shape[0]
    p = np.zeros((m, 3))
    q = np.zeros((m, 3))
    for i in range(m):
        for c in range(4):
            for a in range(3):
                p[i, a] += value[i, c] * control[first[i] + c, a]
                q[i, a] += value[i, c] * control[first[i] + c, 3 + a]
    normal = np.empty((m, fractions.shape[0], 3))
    motion_errors(
        breaks_u, breaks_v, coefficients, box, sense, raster, p, q, fractions, radii, u, v, error, normal, on, warm
    )
    there = 0
    for i in range(m):
        for j in range(fractions.shape[0]):
            if on[i, j] > 0.5:
                there += 1
    if there < LEAST_SAMPLES:
        return LOST, 0.0

    size = control.size
    band = np.zeros((24, size))
    right = np.zeros(size)
    weight = np.empty(error.shape)
    sample_weights(error, on, over, scale, barrier, weight)
    weight *= weights[0] / there
    add_errors(band, right, first, value, fractions, normal, error, weight)
    curvature = np.empty((m, 6))
    d = np.empty((m, 3))
    excess = np.empty(m)
    velocity = np.empty((m, 3))
    speed = np.empty(m)
    cosine = np.empty(m)
    axis_path(first, value, slope, bend, control, length, curvature, d, excess, velocity, speed, cosine)
    add_path(
        band, right, first, value, slope, bend, curvature, d, excess, speed, cosine,
        stiff * weights[3] / m, weights[2] / (2 * m), fade * weights[1] / (2 * m * speed.mean() ** 4),
        fade * weights[4] / m,
    )  # fmt: skip
    step = np.empty(size)
    if not solve(band, right, step):
        return SINGULAR, 0.0
    promised = 0.0
    longest = 0.0
    for k in range(size):
        promised += step[k] * right[k]
        longest = max(longest, abs(step[k]))
    share = min(1.0, LONGEST_STEP / longest) if longest > 0.0 else 0.0
    for k in range(size):
        control[k // 6, k % 6] += share * step[k]
    return TAKEN, promised
