"""Where edges are in the picture, along its rows and columns.

The search runs along the row where an edge is steep, else along the column, so whole pixels are
read and none are interpolated. A pixel's grey level is the mean over its square. So where a
straight edge parts two even grey levels, the sum of the levels over a row tells exactly at which
column the edge crosses the middle of that row.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

MAX_CANDIDATES = 4  # of one point, at most
MAX_LEVEL_PIXELS = 3  # pixels of which an even grey level is taken, at most
SEARCH_SLACK = 0.35  # px by which an edge may be off where it is measured, without loss
MAX_DISTANCE = 1.5  # px from where it was expected at which an edge is measured, at most
MAX_UNEVENNESS = 0.35  # part of the contrast by which the pixels of one level may differ
UNKNOWN_LEVEL = -1.0  # a grey level that is not
LEARNING_RATE = 0.2  # part of a remembered level that a picture renews
NOISE_ROWS = 8  # of a picture, in which its noise is measured


@jit("u1[:,:], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8")
def find_candidates(grey, pixel, normal, expected_levels, reach, min_change, tolerance):
    """Places of steepest change within `reach` px of each point, the nearest first.

    Args:
        pixel, normal: (n, 2) as of EdgePoints. expected: (n, 2) grey levels on the normal's side
            and on the other; UNKNOWN: any.
        least: grey levels of a change. tolerance: of a level that is expected.

    Answers (n, CANDIDATES) px along the normal, NaN where there are no more.
    """
    rows, columns = grey.shape
    found = np.full((len(pixel), MAX_CANDIDATES), np.nan)
    change = np.empty(2 * int(reach * 1.5) + 9)
    for n in range(len(pixel)):
        k = 0 if abs(normal[n, 0]) >= abs(normal[n, 1]) else 1
        along = normal[n, k]
        line = int(np.rint(pixel[n, 1 - k]))
        # Where the edge crosses the middle of this row or column.
        here = pixel[n, k] - (line - pixel[n, 1 - k]) * normal[n, 1 - k] / along
        middle = int(np.rint(here))
        span = int(reach / abs(along)) + 1
        limit = columns if k == 0 else rows
        low, high = max(middle - span, 2), min(middle + span, limit - 4)
        other = rows if k == 0 else columns
        if line < 0 or line >= other or high - low < 2:
            continue
        for i in range(low, high + 1):  # between pixels i and i + 1
            if k == 0:
                step = (np.float64(grey[line, i + 1]) + grey[line, i + 2]
                        - grey[line, i] - grey[line, i - 1])  # fmt: skip
            else:
                step = (np.float64(grey[i + 1, line]) + grey[i + 2, line]
                        - grey[i, line] - grey[i - 1, line])  # fmt: skip
            change[i - low] = 0.5 * step
        count = 0
        for i in range(low + 1, high):
            c = abs(change[i - low])
            before, behind = abs(change[i - low - 1]), abs(change[i - low + 1])
            if c < min_change or c < before or c <= behind:
                continue
            if k == 0:
                left = 0.5 * (np.float64(grey[line, i - 2]) + grey[line, i - 1])
                right = 0.5 * (np.float64(grey[line, i + 2]) + grey[line, i + 3])
            else:
                left = 0.5 * (np.float64(grey[i - 2, line]) + grey[i - 1, line])
                right = 0.5 * (np.float64(grey[i + 2, line]) + grey[i + 3, line])
            with_normal, against = (right, left) if along > 0.0 else (left, right)
            if (
                expected_levels[n, 0] >= 0.0
                and abs(with_normal - expected_levels[n, 0]) > tolerance
            ) or (
                expected_levels[n, 1] >= 0.0 and abs(against - expected_levels[n, 1]) > tolerance
            ):
                continue
            bend = before - 2.0 * c + behind
            shift = 0.5 * (before - behind) / bend if bend < 0.0 else 0.0
            away = (i + 0.5 + shift - here) * along
            # Kept in order of distance.
            place = count
            while place > 0 and abs(found[n, place - 1]) > abs(away):
                if place < MAX_CANDIDATES:
                    found[n, place] = found[n, place - 1]
                place -= 1
            if place < MAX_CANDIDATES:
                found[n, place] = away
                count = min(count + 1, MAX_CANDIDATES)
    return found


@jit("u1[:,:], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8")
def measure_edges(grey, pixel, normal, room, expected_levels, min_change, tolerance, noise):
    """Each point's edge by the grey levels' sum over the change.

    Args:
        as of `find_candidates`. room: as of EdgePoints. noise: of a pixel, grey levels, rms.

    Answers:
        (n, 4): px along the normal, NaN where none is measured; the grey levels on the side of the
        normal and on the other; the measurement's variance by the noise, px^2.
    """
    rows, columns = grey.shape
    found = np.full((len(pixel), 4), np.nan)
    values = np.empty(32)
    for n in range(len(pixel)):
        k = 0 if abs(normal[n, 0]) >= abs(normal[n, 1]) else 1
        along, slope = normal[n, k], abs(normal[n, 1 - k] / normal[n, k])
        line = int(np.rint(pixel[n, 1 - k]))
        here = pixel[n, k] - (line - pixel[n, 1 - k]) * normal[n, 1 - k] / along
        limit, other = (columns, rows) if k == 0 else (rows, columns)
        if line < 0 or line >= other:
            continue
        place, good = here, False
        contrast, level = 0.0, np.zeros(2)
        inside = counted = 0
        slope_of = 0.0
        for _ in range(3):
            # Pixels that the edge touches: half the change's width to either side.
            half = 0.5 * (1.0 + slope) + SEARCH_SLACK
            first, last = int(np.ceil(place - half)), int(np.floor(place + half))
            before = min(
                MAX_LEVEL_PIXELS, int(first - 1 - (here - room[n, 0] + 0.5 + 0.5 * slope) + 1.0)
            )
            behind = min(
                MAX_LEVEL_PIXELS, int(here + room[n, 1] - 0.5 - 0.5 * slope - (last + 1) + 1.0)
            )
            good = before >= 1 and behind >= 1 and first - before >= 0 and last + behind < limit
            if not good:
                break
            low, high = first - before, last + behind
            for i in range(low, high + 1):
                values[i - low] = grey[line, i] if k == 0 else grey[i, line]
            count = high - low + 1
            left = right = 0.0
            for i in range(before):
                left += values[i] / before
            for i in range(behind):
                right += values[count - 1 - i] / behind
            contrast = right - left
            good = abs(contrast) >= min_change
            if not good:
                break
            spread = 0.0
            for i in range(before):
                spread = max(spread, abs(values[i] - left))
            for i in range(behind):
                spread = max(spread, abs(values[count - 1 - i] - right))
            slope_of = max(spread - 3.0 * noise, 0.0)
            if slope_of > 0.0:  # shaded: the levels next to the edge count
                left, right = values[before - 1], values[count - behind]
                if before > 1:
                    left += 0.5 * (left - values[before - 2])
                if behind > 1:
                    right += 0.5 * (right - values[count - behind + 1])
                contrast = right - left
                good = abs(contrast) >= min_change
                if not good:
                    break
            good = spread <= MAX_UNEVENNESS * abs(contrast) + 3.0 * noise
            if not good:
                break
            share = 0.0
            for i in range(before, count - behind):
                share += (right - values[i]) / contrast
            new = first - 0.5 + share
            level[0], level[1] = left, right
            inside, counted = count - before - behind, min(before, behind)
            moved, place = abs(new - place), new
            if abs(place - here) > MAX_DISTANCE:
                good = False
                break
            if moved < 0.3 * SEARCH_SLACK:
                break
        if not good:
            continue
        with_normal, against = (level[1], level[0]) if along > 0.0 else (level[0], level[1])
        if (
            expected_levels[n, 0] >= 0.0 and abs(with_normal - expected_levels[n, 0]) > tolerance
        ) or (expected_levels[n, 1] >= 0.0 and abs(against - expected_levels[n, 1]) > tolerance):
            continue
        found[n, 0] = (place - here) * along
        found[n, 1], found[n, 2] = with_normal, against
        around = inside + 0.5 * inside * inside / counted
        found[n, 3] = around * ((noise + slope_of) / contrast) ** 2 * along * along
    return found


@jit("u1[:,:]")
def estimate_noise(grey):
    """Standard deviation of a pixel's noise, grey levels, of a picture that is smooth mostly."""
    rows, columns = grey.shape
    counts, total = np.zeros(1021, np.int64), 0
    for v in range(0, rows, max(rows // NOISE_ROWS, 1)):
        for u in range(1, columns - 1):
            bend = 2 * np.int64(grey[v, u]) - np.int64(grey[v, u - 1]) - np.int64(grey[v, u + 1])
            counts[abs(bend)] += 1
            total += 1
    low, high, passed = -1, -1, 0
    for bend in range(len(counts)):  # the median
        passed += counts[bend]
        if low < 0 and 2 * passed >= total:
            low = bend
        if high < 0 and 2 * passed > total:
            high = bend
            break
    return 1.4826 * 0.5 * (low + high) / np.sqrt(6.0) if total else 0.0


@jit("i8[::1], b1[:,::1], f8[:,::1]")
def predict_levels(edge, facing, levels):
    """Grey levels (n, 2) on both sides of points, as remembered of their edges.

    Args:
        edge, facing: as of EdgePoints. levels: (E, 2) of the edges; UNKNOWN: not known.
    """
    found = np.full((len(edge), 2), UNKNOWN_LEVEL)
    for n in range(len(edge)):
        for side in range(2):
            if facing[n, side]:
                found[n, side] = levels[edge[n], side]
    return found


@jit("f8[:,::1], i8[::1], b1[:,::1], f8[:,::1], f8[::1], f8")
def update_levels(levels, edge, facing, values, residuals, inlier_distance):
    """Renew the levels of edges by those of their points whose residuals (n,) are less than
    `inlier_distance` px; arguments as of `predict_levels`, and what `measure_edges` answers."""
    total, count = np.zeros(levels.shape), np.zeros(levels.shape)
    for n in range(len(edge)):
        for side in range(2):
            if facing[n, side] and abs(residuals[n]) < inlier_distance:
                total[edge[n], side] += values[n, 1 + side]
                count[edge[n], side] += 1.0
    for e in range(len(levels)):
        for side in range(2):
            if count[e, side] > 0.0:
                mean, known = total[e, side] / count[e, side], levels[e, side]
                levels[e, side] = mean if known < 0.0 else known + LEARNING_RATE * (mean - known)
