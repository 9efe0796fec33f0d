"""Compiled loops of `perception.geometry.rounded`.

Importing this module loads numba: do so when a frame is measured, not at the top of a module.
"""

from __future__ import annotations

import math

import numpy as np

from stair_env.common.compiling import njit

UNKNOWN, TREAD, RISER = 0, 1, 2
FIRST_ROUNDS = 2  # without the steps' likeness, whose equations need a first solution
ROUNDS = 7
MAX_UNKNOWN_SHARE = 0.15  # of a row that an unexplained strip may have blurred into it
UNKNOWN_OUTSIDE = 0.3  # what leaving a row before or behind all lines unexplained costs, of one between them
MAX_TURN = 0.06  # radians per round
FIRST_RISER = 2.5  # times as unlike: floors are laid after the stairs
SETTLED = 3e-4  # radians, or share of an inverse distance, below which no further round is worth its time
TAIL = 1.0  # degrees of freedom of what gravity may be off by
RIDGE = 1e-2  # m^2: a face that nothing is known of stays at infinity instead of making the equations singular


@njit(cache=True, nogil=True, error_model="numpy")
def blur_weights(edges: np.ndarray, width: float, rows: int, weight: np.ndarray, moment: np.ndarray) -> None:
    """Share of every face in every row, once the section is blurred by a Gaussian along the rows.

    Args:
        edges: (m,) rows at which face i ends and face i + 1 begins, increasing.
        width: standard deviation of the blur, rows.
        rows: how many rows there are.
        weight: (rows, m + 1) written; sums to one.
        moment: (rows, m + 1) written: mean offset of that share from the row, rows, times the share.
    """
    count = len(edges)
    for j in range(rows):
        before, before_density = 1.0, 0.0
        for i in range(count):
            t = (j - edges[i]) / width
            if t > 5.0:
                after, density = 1.0, 0.0
            elif t < -5.0:
                after, density = 0.0, 0.0
            else:
                after = 0.5 * (1.0 + math.erf(t * 0.7071067811865476))
                density = 0.3989422804014327 * math.exp(-0.5 * t * t)
            weight[j, i] = before - after
            moment[j, i] = width * (before_density - density)
            before, before_density = after, density
        weight[j, count] = before
        moment[j, count] = width * before_density


@njit(cache=True, nogil=True, error_model="numpy")
def fit(
    inverse_depth: np.ndarray,
    row_weight: np.ndarray,
    angle: np.ndarray,
    per_depth: np.ndarray,
    weight: np.ndarray,
    moment: np.ndarray,
    line_angle: np.ndarray,
    line_std: np.ndarray,
    kind: np.ndarray,
    noise: tuple[float, float, float, float],
    turn_std: float,
    likeness: tuple[float, float, float, float, float],
    inverse: np.ndarray,
    covariance: np.ndarray,
    answer: np.ndarray,
) -> None:
    """Gauss-Newton, robust: faces, pitch and the flight's usual step from all rows and all lines together.

    A tread of height H is seen under the angle a at the inverse distance sin(a) / H, a riser at cos(a) / F, so that
    everything is linear in 1 / H and 1 / F but for the pitch, which adds to a, and the likeness of the steps.

    Args:
        inverse_depth: (J,) of the rows, 1 / m, 0 where there is nothing.
        row_weight: (J,) how much a row counts, 0 to 1.
        angle: (J,) of the rows above the horizontal, radians.
        per_depth: (J,) distance in the section per depth.
        weight, moment: (J, K) of `blur_weights`.
        line_angle, line_std: (K - 1,) at which angle the lines are seen, radians.
        kind: (K,) UNKNOWN, TREAD or RISER.
        noise: standard deviation of an inverse depth at first, 1 / m; rows per independent reading; residual in
            standard deviations from which a row has no weight; least standard deviation that the scatter of the rows
            may narrow it down to, 1 / m.
        turn_std: of the pitch about answer[0], radians; with long tails.
        likeness: standard deviation of a step's lengths about the usual ones, m; usual riser and tread of any stairs,
            m; how much they vary, m; +1 going up, -1 down.
        inverse: (K,) 1 / m; first guess, and written.
        covariance: (K + 3, K + 3) of 1 / H or 1 / F of every face, pitch, usual riser, usual tread; written.
        answer: (6,) pitch in the middle of its prior and first guess, then written: pitch, cost (twice the negative
            logarithm of the likelihood), standard deviation of a row, share of the rows explained, usual riser, and
            usual tread.
    """
    rows, faces = weight.shape
    size = faces + 3
    pitch, middle = answer[1], answer[0]
    riser, tread = likeness[1], likeness[2]
    sign = likeness[4]
    sigma, per_reading, cut = noise[0], noise[1], noise[2]
    normal = np.empty((size, size))
    right = np.empty(size)
    column = np.empty(faces)
    scatter = np.empty(rows)
    cost, explained, counted = 0.0, 0.0, 0.0
    settled = False
    for turn in range(ROUNDS + 1):
        last = settled or turn == ROUNDS
        normal[:] = 0.0
        right[:] = 0.0
        cost, explained, counted = 0.0, 0.0, 0.0
        spread = 0
        for j in range(rows):
            if inverse_depth[j] <= 0.0 or row_weight[j] <= 0.0:
                continue
            sin, cos = math.sin(angle[j] + pitch), math.cos(angle[j] + pitch)
            ahead, behind = min(j + 1, rows - 1), max(j - 1, 0)
            step = (angle[ahead] - angle[behind]) / (ahead - behind)
            bend = (per_depth[ahead] - per_depth[behind]) / (ahead - behind)
            k = per_depth[j]
            model, slope, unknown = 0.0, 0.0, 0.0
            first, end = faces, 0  # of the faces that are blurred into this row
            for i in range(faces):
                w, m = weight[j, i], moment[j, i]
                if w < 1e-4 and abs(m) < 1e-4:
                    column[i] = 0.0
                    continue
                first, end = min(first, i), i + 1
                if kind[i] == TREAD:
                    column[i] = w * k * sin + m * (k * cos * step + bend * sin)
                    slope += inverse[i] * w * k * cos
                elif kind[i] == RISER:
                    column[i] = w * k * cos + m * (-k * sin * step + bend * cos)
                    slope -= inverse[i] * w * k * sin
                else:
                    column[i] = 0.0
                    unknown += w
                model += column[i] * inverse[i]
            if unknown > MAX_UNKNOWN_SHARE:
                lost = row_weight[j] * (1.0 if weight[j, 0] + weight[j, faces - 1] < 0.5 else UNKNOWN_OUTSIDE)
                cost += lost * cut * cut / 3.0 / per_reading
                counted += lost
                continue
            off = inverse_depth[j] - model
            scatter[spread] = abs(off)
            spread += 1
            chi = off / sigma
            share = chi / cut
            counted += row_weight[j]
            # The first round has no guess to be far from.
            robust = (1.0 - share * share) ** 2 if abs(share) < 1.0 else 0.0
            if turn == 0:
                robust = 1.0
            one = 1.0 - share * share if abs(share) < 1.0 else 0.0
            cost += row_weight[j] * cut * cut / 3.0 * (1.0 - one**3) / per_reading
            explained += row_weight[j] * (1.0 if abs(share) < 1.0 else 0.0)
            a = row_weight[j] * robust / (sigma * sigma * per_reading)
            if a <= 0.0:
                continue
            for i in range(first, end):
                right[i] += a * column[i] * off
                normal[i, faces] += a * column[i] * slope
                for n in range(i, end):
                    normal[i, n] += a * column[i] * column[n]
            normal[faces, faces] += a * slope * slope
            right[faces] += a * slope * off
        for i in range(faces - 1):
            if kind[i] == UNKNOWN or kind[i + 1] == UNKNOWN or kind[i] == kind[i + 1]:
                continue
            flat, up = (i, i + 1) if kind[i] == TREAD else (i + 1, i)
            sin, cos = math.sin(line_angle[i] + pitch), math.cos(line_angle[i] + pitch)
            off = inverse[flat] * sin - inverse[up] * cos
            by_pitch = inverse[flat] * cos + inverse[up] * sin
            std = max(abs(by_pitch) * line_std[i], 1e-5)
            chi = off / std
            a = 1.0 / (std * std)
            if turn >= FIRST_ROUNDS:
                a /= 1.0 + (chi / 4.0) ** 2
            cost += 16.0 * math.log(1.0 + (chi / 4.0) ** 2)
            low, high = min(flat, up), max(flat, up)
            first = sin if low == flat else -cos
            second = -cos if low == flat else sin
            normal[low, low] += a * first * first
            normal[low, high] += a * first * second
            normal[high, high] += a * second * second
            normal[low, faces] += a * first * by_pitch
            normal[high, faces] += a * second * by_pitch
            normal[faces, faces] += a * by_pitch * by_pitch
            right[low] -= a * first * off
            right[high] -= a * second * off
            right[faces] -= a * by_pitch * off
        # Student's distribution: gravity is nearly right, or else it may be anything.
        off = pitch - middle
        a = (TAIL + 1.0) / (TAIL * turn_std * turn_std + off * off)
        normal[faces, faces] += a
        right[faces] -= a * off
        cost += (TAIL + 1.0) * math.log(1.0 + off * off / (TAIL * turn_std * turn_std))
        a = 1.0 / likeness[3] ** 2
        normal[faces + 1, faces + 1] += a
        right[faces + 1] -= a * (riser - likeness[1])
        normal[faces + 2, faces + 2] += a
        right[faces + 2] -= a * (tread - likeness[2])
        if turn >= FIRST_ROUNDS:
            for i in range(faces):
                if kind[i] == UNKNOWN or abs(inverse[i]) < 1e-3:
                    continue
                other = i + 1
                if sign > 0.0:
                    other = i + 2 if i + 1 < faces and kind[i + 1] != kind[i] else i + 1
                if other >= faces or kind[other] != kind[i] or abs(inverse[other]) < 1e-3:
                    continue
                here, there = 1.0 / inverse[i], 1.0 / inverse[other]
                usual = faces + 1 if kind[i] == TREAD else faces + 2
                expected = sign * riser if kind[i] == TREAD else tread
                way = sign if kind[i] == TREAD else 1.0
                off = there - here - expected
                std = likeness[0]
                if kind[i] == TREAD and (i == 0 or (i == 1 and kind[0] != TREAD)):
                    std *= FIRST_RISER
                a = 1.0 / (std * max(abs(off), std))  # Huber: one step may be quite unlike the others
                cost += a * off * off
                d_here, d_there = here * here, -there * there
                normal[i, i] += a * d_here * d_here
                normal[i, other] += a * d_here * d_there
                normal[other, other] += a * d_there * d_there
                normal[i, usual] -= a * d_here * way
                normal[other, usual] -= a * d_there * way
                normal[usual, usual] += a
                right[i] -= a * d_here * off
                right[other] -= a * d_there * off
                right[usual] += a * way * off
                if sign < 0.0 and kind[i] == TREAD and i + 2 < faces:
                    # Nosings are where the lines cross the treads.
                    t0, t1 = math.tan(line_angle[i] + pitch), math.tan(line_angle[other] + pitch)
                    if t0 > -0.02 or t1 > -0.02:
                        continue
                    off = there / t1 - here / t0 - tread
                    std = likeness[0]
                    a = 1.0 / (std * max(abs(off), std))
                    cost += a * off * off
                    g0, g1 = here * here / t0, -there * there / t1
                    gp = here * (1.0 + t0 * t0) / (t0 * t0) - there * (1.0 + t1 * t1) / (t1 * t1)
                    normal[i, i] += a * g0 * g0
                    normal[i, other] += a * g0 * g1
                    normal[other, other] += a * g1 * g1
                    normal[i, faces] += a * g0 * gp
                    normal[other, faces] += a * g1 * gp
                    normal[faces, faces] += a * gp * gp
                    normal[i, faces + 2] -= a * g0
                    normal[other, faces + 2] -= a * g1
                    normal[faces, faces + 2] -= a * gp
                    normal[faces + 2, faces + 2] += a
                    right[i] -= a * g0 * off
                    right[other] -= a * g1 * off
                    right[faces] -= a * gp * off
                    right[faces + 2] += a * off
        for i in range(size):
            normal[i, i] += RIDGE if i < faces else 0.0
            for n in range(i):
                normal[i, n] = normal[n, i]
        if last:
            break
        step_vector = np.linalg.solve(normal, right)
        turned = float(step_vector[faces])
        if abs(turned) > MAX_TURN:
            turned = math.copysign(MAX_TURN, turned)
        if turn == 0:  # without faces yet, only the prior would move it
            turned = 0.0
        settled = turn > FIRST_ROUNDS and abs(turned) < SETTLED
        for i in range(faces):
            settled = settled and abs(step_vector[i]) < SETTLED * max(abs(inverse[i]), 1.0)
            inverse[i] += step_vector[i]
        pitch += turned
        riser += step_vector[faces + 1]
        tread += step_vector[faces + 2]
        if turn >= 1 and spread > 0:
            sigma = max(noise[3], 1.4826 * np.partition(scatter[:spread], spread // 2)[spread // 2])
    cost += 2.0 * counted / per_reading * math.log(sigma / noise[3])
    covariance[:] = np.linalg.inv(normal)
    answer[0] = pitch
    answer[1] = cost
    answer[2] = sigma
    answer[3] = explained / counted if counted > 0.0 else 0.0
    answer[4] = riser
    answer[5] = tread
