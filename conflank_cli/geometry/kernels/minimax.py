"""The least maximum of errors that change linearly: a linear program in four unknowns, by an interior point method."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.small_systems import factorise, substitute

# What takes part in the maximum: nothing of an error, only its negative part, or its modulus.
IGNORED, LOWER, BOTH = 0, 1, 2
# Steps at most; eight are usual. Stopped where the maximum is known to this share of what it is at first.
ITERATIONS = 20
RELATIVE_GAP = 1e-2
# The share of the way to the nearest constraint that a step may go.
SHORT_OF_BORDER = 0.98


@njit(cache=True)
def least_maximum(rows, error, kind, limit, change):
    """Make the largest of |error + rows change| least, no component of the change being larger than `limit`.

    rows (J, 3), error (J,), kind (J,) of IGNORED, LOWER (only negative errors count), BOTH. Fills change (3,) and
    returns that maximum, to about RELATIVE_GAP of the one at change 0.

    Source: Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optimization 2 (1992).
    """
    for k in range(3):
        change[k] = 0.0
    scale = 0.0
    for j in range(error.shape[0]):
        if kind[j] != IGNORED:
            scale = max(scale, -error[j] if kind[j] == LOWER else abs(error[j]))
    if scale <= 0.0:
        return 0.0
    # Constraints a y <= b in y = (change, maximum), everything in units of the maximum at first.
    most = 2 * error.shape[0] + 6
    a = np.zeros((most, 4))
    b = np.empty(most)
    count = 0
    for j in range(error.shape[0]):
        for sign in (-1.0, 1.0):
            if kind[j] == BOTH or (kind[j] == LOWER and sign < 0.0):
                for k in range(3):
                    a[count, k] = sign * rows[j, k]
                a[count, 3] = -1.0
                b[count] = -sign * error[j] / scale
                count += 1
    for k in range(3):
        for sign in (-1.0, 1.0):
            a[count, k] = sign
            b[count] = limit / scale
            count += 1
    y, residual = np.zeros(4), np.empty(4)
    y[3] = 1.5
    slack = np.empty(count)
    force = np.empty(count)
    slack_step = np.empty(count)
    force_step = np.empty(count)
    matrix = np.empty((4, 4))
    right = np.empty(4)
    step = np.empty(4)
    for i in range(count):
        slack[i] = b[i] - a[i, 3] * y[3]
        force[i] = 1.0 / count
    for _ in range(ITERATIONS):
        gap = 0.0
        for i in range(count):
            gap += slack[i] * force[i]
        for k in range(4):
            residual[k] = 1.0 if k == 3 else 0.0
            for m in range(4):
                matrix[k, m] = 0.0
        for i in range(count):
            weight = force[i] / slack[i]
            for k in range(4):
                residual[k] += a[i, k] * force[i]
                for m in range(k + 1):
                    matrix[k, m] += weight * a[i, k] * a[i, m]
        worst = 0.0
        for k in range(4):
            worst = max(worst, abs(residual[k]))
        if gap < RELATIVE_GAP and worst < RELATIVE_GAP:
            break
        factorise(matrix)
        target = 0.0
        for attempt in range(2):
            # First straight to the optimum; from how far that gets, the second chooses what products to aim at.
            for k in range(4):
                right[k] = -residual[k]
            for i in range(count):
                product = target - (slack_step[i] * force_step[i] if attempt == 1 else 0.0)
                for k in range(4):
                    right[k] += a[i, k] * (force[i] - product / slack[i])
            substitute(matrix, right, step)
            longest = 1.0 / SHORT_OF_BORDER
            longest_force = longest
            for i in range(count):
                product = target - (slack_step[i] * force_step[i] if attempt == 1 else 0.0)
                change_of_slack = 0.0
                for k in range(4):
                    change_of_slack -= a[i, k] * step[k]
                slack_step[i] = change_of_slack
                force_step[i] = (product - force[i] * change_of_slack) / slack[i] - force[i]
                if slack_step[i] < 0.0:
                    longest = min(longest, -slack[i] / slack_step[i])
                if force_step[i] < 0.0:
                    longest_force = min(longest_force, -force[i] / force_step[i])
            longest = min(1.0, SHORT_OF_BORDER * longest)
            longest_force = min(1.0, SHORT_OF_BORDER * longest_force)
            if attempt == 0:
                after = 0.0
                for i in range(count):
                    after += (slack[i] + longest * slack_step[i]) * (force[i] + longest_force * force_step[i])
                target = (after / gap) ** 3 * gap / count
        for k in range(4):
            y[k] += longest * step[k]
        for i in range(count):
            slack[i] += longest * slack_step[i]
            force[i] += longest_force * force_step[i]
    for k in range(3):
        change[k] = scale * y[k]
    return scale * y[3]
