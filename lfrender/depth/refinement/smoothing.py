"""Lenses on one surface measure it together: each patch size weighed with those of the lenses around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ...flat.lens_graph import distant_rings, two_rings
from ...runtime.scheduling import plan_chunks
from .lens_plane import LensFits

__all__ = ["SmoothedFits", "smooth_fits", "smooth_fits_far"]

# Lenses farther apart than this many standard deviations hardly count as one surface, and from the second number on not
# at all: one that knows itself far better than those about it would else draw them to another surface.
_APART, _ELSEWHERE = 3.0, 6.0
# No surface is even, and no slant better known than to this.
_LEAST_SLANT = 0.002
# Bends of surfaces [pitches of s per squared pitch of the scene] are about so large. One is believed as far as its
# square exceeds so many times its variance: on flat surfaces there is none.
_BENT, _CHANCE = 0.007, 5.0
# Half the mean square distance [pitches^2] of what a lens sees from its middle, at most: the lenses around tell no bend
# farther off.
_FARTHEST = 1.0
# How far the lenses about one scatter beyond their errors is found in so many rounds.
_ROUNDS = 3
# Lenses that together weigh less than one half say nothing.
_LEAST_WEIGHT = 0.5
# Neighbours share pixels, pairs, and what misleads them: correlation of their errors. Some error [px] all lenses of a
# surface share; it grows [pitches] with the cube of |s| / D, as neighbours come to share no more than their rims.
# Measured on ray-traced scenes.
_SHARED = 0.03
_UNSEEN, _UNSEEN_GROWTH = 0.0019, 0.0005
# Lenses afar are asked so many times: those that they have asked tell of what is farther.
_TURNS = 2
# On a plane, errors alone leave so much agreement. Lenses with less count afar by this power of what they have of it.
_AGREED, _STEEPNESS = np.float32(0.83), 8


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inverted(a, b, c, d, e, f):
    """Inverse of the symmetric matrix ((a, b, c), (b, d, e), (c, e, f)): its upper half, and a factor to it."""
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    return i00, i01, i02, a * f - c * c, b * c - a * e, a * d - b * b, 1 / (a * i00 + b * i01 + c * i02)


# Exact sums, here and below: with fast math they would have other bits where Numba compiles than where it loads them.
# Divisions are in loops without sums, which are vector loops as they are, but for Python's error model.
@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _plane_sums(count, away, variance, share, along_x, along_y, uneven, weights):
    """Weighted sums of squared weights, of 1, x, y, their products, and of all that with differences."""
    for k in range(np.uint64(count)):
        weights[k] = share[k] / (variance[k] + uneven)
    squares = a = b = c = d = e = f = p = q = r = 0.0
    for k in range(np.uint64(count)):
        w, x, y, rest = weights[k], along_x[k], along_y[k], away[k]
        wx, wy, wr = w * x, w * y, w * rest
        squares += w * w
        a += w
        b += wx
        c += wy
        d += wx * x
        e += wx * y
        f += wy * y
        p += wr
        q += wr * x
        r += wr * y
    return squares, a, b, c, d, e, f, p, q, r


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _scatter(count, away, share, along_x, along_y, weights, height, x_slant, y_slant):
    """Weighted sum of the squares that a plane leaves, and sum of the shares."""
    scatter = number = 0.0
    for k in range(np.uint64(count)):
        rest = away[k] - height - x_slant * along_x[k] - y_slant * along_y[k]
        scatter += weights[k] * rest * rest
        number += share[k]
    return scatter, number


@njit(cache=True, nogil=True, error_model="numpy")
def _expect(count, told, slant_known):
    """What `count` lenses expect of another: difference from what it says itself, variance, and shared variance; by how
    much their slant differs from its own, and the variance of that.

    A weighted plane through the differences of what they have `told`. What they scatter about it beyond their variances
    is as likely the surface's own unevenness (DerSimonian and Laird, Meta-analysis in clinical trials, 1986), which the
    other lens has as well.
    """
    away, variance, share, along_x, along_y, weights = told[0], told[1], told[2], told[3], told[4], told[11]
    uneven = height = inverse = total = x_slant = y_slant = slanted = 0.0
    for turn in range(_ROUNDS):
        squares, a, b, c, d, e, f, p, q, r = _plane_sums(
            count, away, variance, share, along_x, along_y, uneven, weights
        )
        total = a
        d += slant_known
        f += slant_known
        i00, i01, i02, i11, i12, i22, over = _inverted(a, b, c, d, e, f)
        height, inverse = (i00 * p + i01 * q + i02 * r) * over, i00 * over
        x_slant, y_slant = (i01 * p + i11 * q + i12 * r) * over, (i02 * p + i12 * q + i22 * r) * over
        slanted = 0.5 * (i11 + i22) * over
        if turn == _ROUNDS - 1:
            break
        scatter, freedom = _scatter(count, away, share, along_x, along_y, weights, height, x_slant, y_slant)
        freedom -= 1 + (1 - i11 * over * slant_known) + (1 - i22 * over * slant_known)
        uneven += max(scatter - freedom + 1, 0.0) / max(a - squares / a, 1e-9)
    return height, inverse + uneven, count / total, -x_slant, -y_slant, slanted


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _bend_sums(count, told, own):
    """Weighted sums over `count` lenses of 1, x, y, the bend, their products, and of all that with differences; the sum
    of the squares of these, and of the shares."""
    away, variance, share, along_x, along_y, bent = told[0], told[1], told[2], told[3], told[4], told[5]
    ahead_x, ahead_y, turned_x, turned_y, turn_variance = told[6], told[7], told[8], told[9], told[10]
    weights, turn_weights = told[11], told[12]
    for k in range(np.uint64(count)):
        weights[k], turn_weights[k] = share[k] / variance[k], share[k] / turn_variance[k]
    a = b = c = d = e = f = g = h = i = j = p = q = r = s = squares = number = 0.0
    for k in range(np.uint64(count)):
        w, x, y, z, rest = weights[k], along_x[k], along_y[k], bent[k], away[k]
        wx, wy, wz, wr = w * x, w * y, w * z, w * rest
        v, u, n = turn_weights[k], ahead_x[k], ahead_y[k]
        turn_x, turn_y, vo = turned_x[k], turned_y[k], v * own
        a += w
        b += wx
        c += wy
        d += wx * x + vo * own
        e += wx * y
        f += wy * y + vo * own
        g += wz
        h += wz * x + vo * u
        i += wz * y + vo * n
        j += wz * z + v * (u * u + n * n)
        p += wr
        q += wr * x - vo * turn_x
        r += wr * y - vo * turn_y
        s += wr * z - v * (u * turn_x + n * turn_y)
        squares += wr * rest + v * (turn_x * turn_x + turn_y * turn_y)
        number += share[k]
    return a, b, c, d, e, f, g, h, i, j, p, q, r, s, squares, number


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(count, told, own, own_variance, own_bent, slant_known, bend_known):
    """How the surface bends [px / pitch^2] that a lens sees at `own`, and `count` others as they have `told`, and the
    variance of that.

    A weighted paraboloid, round since a slant in each direction and one bend are all that so few lenses tell. Over a
    plane all slants are the same; it changes them. Lenses that scatter about it make it as much less certain.
    """
    a, b, c, d, e, f, g, h, i, j, p, q, r, s, squares, number = _bend_sums(count, told, own)
    # The lens itself differs by nothing from what it says.
    a += 1 / own_variance
    g += own_bent / own_variance
    j += own_bent * own_bent / own_variance
    d += slant_known
    f += slant_known
    i00, i01, i02, i11, i12, i22, over = _inverted(a, b, c, d, e, f)
    # A plane, and by how much it changes with the bend.
    height, by_height = (i00 * p + i01 * q + i02 * r) * over, (i00 * g + i01 * h + i02 * i) * over
    x_slant, by_x = (i01 * p + i11 * q + i12 * r) * over, (i01 * g + i11 * h + i12 * i) * over
    y_slant, by_y = (i02 * p + i12 * q + i22 * r) * over, (i02 * g + i12 * h + i22 * i) * over
    left = s - by_height * p - by_x * q - by_y * r
    spread = 1 / (j - by_height * g - by_x * h - by_y * i + bend_known)
    scatter = squares - height * p - x_slant * q - y_slant * r - spread * left * left
    freedom = 3 * number - 1 - (1 - i11 * over * slant_known) - (1 - i22 * over * slant_known)
    return spread * left, spread * max((scatter + 1) / (max(freedom, 0.0) + 1), 1.0)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seen_about(size, radius):
    """Half the mean square distance [pitches^2], on the scene, between what a lens shows and what its centre does."""
    return min(radius * radius / (4 * size * size), _FARTHEST)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _compare(count, own, own_variance, slant_x, slant_y, slant_variance, radius, seen, told):
    """Fill `told` from what lenses are `seen` to measure; returns what they count together."""
    sizes, variance, ahead_x, ahead_y, slants_x, slants_y = seen[0], seen[1], seen[2], seen[3], seen[4], seen[5]
    slant_variances, shown, trust = seen[6], seen[7], seen[8]
    away, variances, share, along_x, along_y, bent = told[0], told[1], told[2], told[3], told[4], told[5]
    out_x, out_y, turned_x, turned_y, turn_variance = told[6], told[7], told[8], told[9], told[10]
    for k in range(np.uint64(count)):
        size, noise, ex, ey = sizes[k], variance[k], ahead_x[k], ahead_y[k]
        # Over a plane 1 / s is linear in X, with the slant -D * grad(s) / s.
        rest = size * (1 + slant_x * ex + slant_y * ey) - own
        away2, size2 = ex * ex + ey * ey, size * size
        apart = rest * rest / (own_variance + noise + slant_variance * size2 * away2)
        doubt = 1 / (1 + apart / (_APART * _APART))
        counts = doubt * doubt * max(1 - apart / (_ELSEWHERE * _ELSEWHERE), 0.0) * trust[k]
        away[k], variances[k], share[k], along_x[k], along_y[k] = rest, noise, counts, size * ex, size * ey
        bent[k] = 0.5 * away2 + shown[k] * _seen_about(size, radius)
        out_x[k], out_y[k] = ex, ey
        turned_x[k], turned_y[k] = own * (slants_x[k] - slant_x), own * (slants_y[k] - slant_y)
        turn_variance[k] = own * own * slant_variances[k]
    weight = 0.0
    for k in range(np.uint64(count)):
        weight += share[k]
    return weight


@njit(cache=True, nogil=True, error_model="numpy")
def _ask_around(
    lens, centres, pitch, radius, two_rings, sizes, errors, slants, slant_errors, centred, trust, seen, told
):  # fmt: skip
    """Fill `told` with what the lenses `two_rings` measure. Returns how many they are, and what they count together.

    In its rows: the difference from what the lens says itself, its variance, and how far it counts; by how much it
    grows with a slant in both directions, and with a bend; by how much slants fall with a bend, by how much they
    differ, times s, and the variance of either. The last two rows are to work in.
    """
    count, near = 0, 1 / np.float64(pitch)
    for k in range(two_rings.shape[1]):
        other = two_rings[lens, k]
        if other < 0:
            break
        if not np.isfinite(errors[other]):
            continue
        seen[0, count], seen[1, count] = sizes[other], np.float64(errors[other]) ** 2
        seen[2, count] = (np.float64(centres[other, 0]) - centres[lens, 0]) * near
        seen[3, count] = (np.float64(centres[other, 1]) - centres[lens, 1]) * near
        seen[4, count], seen[5, count] = slants[other, 0], slants[other, 1]
        seen[6, count] = np.float64(slant_errors[other]) ** 2 + _LEAST_SLANT**2
        seen[7, count], seen[8, count] = 1 - centred[other], trust[lens] * trust[other]
        count += 1
    weight = _compare(
        count, np.float64(sizes[lens]), np.float64(errors[lens]) ** 2, np.float64(slants[lens, 0]),
        np.float64(slants[lens, 1]), np.float64(slant_errors[lens]) ** 2 + _LEAST_SLANT**2, np.float64(radius),
        seen, told,
    )  # fmt: skip
    return count, weight


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _pool(
    centres, pitch, radius, two_rings, sizes, errors, slants, slant_errors, wanted, centred, trust, out, out_errors,
    out_slants, out_slant_errors, bent, agreed,
):  # fmt: skip
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        seen, told = np.empty((9, two_rings.shape[1])), np.empty((13, two_rings.shape[1]))
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
            own, own_variance = np.float64(sizes[lens]), np.float64(errors[lens]) ** 2
            out[lens], out_errors[lens], bent[lens] = sizes[lens], errors[lens], 0.0
            out_slants[lens], out_slant_errors[lens], agreed[lens] = slants[lens], slant_errors[lens], 1.0
            if not (wanted[lens] and np.isfinite(own_variance)):
                continue
            count, weight = _ask_around(
                lens, centres, pitch, radius, two_rings, sizes, errors, slants, slant_errors, centred, trust, seen, told
            )
            agreed[lens] = weight / max(count, 1)
            if weight < _LEAST_WEIGHT:
                continue
            slant_known = 1 / (np.float64(slant_errors[lens]) ** 2 + _LEAST_SLANT**2)
            shown = (1 - centred[lens]) * _seen_about(own, radius)
            bend, doubt = _bend(count, told, own, own_variance, shown, slant_known, 1 / (_BENT * pitch) ** 2)
            bent[lens] = bend * bend / doubt
            bend *= max(1 - _CHANCE * doubt / (bend * bend), 0.0)
            # What all of them show of the bend, the lens itself too, is taken from what they measure.
            misled = shown * shown * doubt if bend != 0 else 0.0
            for k in range(count):
                told[0, k] += bend * (shown - told[5, k])
            own_variance += misled
            expected, uncertain, shared, x_slant, y_slant, slanted = _expect(count, told, slant_known)
            if expected * expected > _APART * _APART * (uncertain + own_variance):
                continue
            out[lens] = own - shown * bend + own_variance / (own_variance + uncertain) * expected
            out_slants[lens, 0] += x_slant
            out_slants[lens, 1] += y_slant
            out_slant_errors[lens] = np.sqrt(slanted)
            joint = own_variance * uncertain / (own_variance + uncertain) + misled
            unseen = _UNSEEN_GROWTH * pitch * abs(own / pitch) ** 3
            out_errors[lens] = np.sqrt(joint + _SHARED * min(shared, own_variance) + _UNSEEN**2 + unseen**2)


@dataclass(frozen=True)
class SmoothedFits:
    """What lenses measure together.

    Parameters
    ----------
    fits : LensFits
    bent : (n,) float32
        How many times its variance the square of the bend is that the lenses about one tell; 0 where they do not.
    agreed : (n,) float32
        Share of the lenses about one that agree with it, 0 to 1.
    """

    fits: LensFits
    bent: NDArray[np.float32]
    agreed: NDArray[np.float32]


def smooth_fits(
    centres: NDArray[np.float32],
    pitch: float,
    radius: float,
    neighbours: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.bool_],
    centred: NDArray[np.float32],
) -> SmoothedFits:
    """Patch sizes, slants and their errors of lenses together with those in two rings around them.

    A lens is weighed with what a plane through the others expects of it. Others count as far as they agree with it,
    and the less the more they scatter: what belongs to several surfaces stays as it is. A microimage measures the mean
    of what it shows, which on a bent surface is not what its centre shows: where lenses tell a bend, the difference is
    taken from all of them, and the plane is that of what is left.

    Parameters
    ----------
    centres : (n, 2) float32 [px]
    pitch, radius : float [px]
        Of the microimages; as far as they are compared.
    neighbours : (n, k) int32
        Neighbour rows in all directions, -1 where there is none.
    fits : LensFits
        What each lens measures alone; those of infinite error say nothing to others.
    wanted : (n,) bool
        The others stay as they are.
    centred : (n,) float32
        How far lenses measure what their centres show, 0 to 1, and not a mean.
    """
    trust = np.ones(len(centres), np.float32)
    return _together(centres, pitch, radius, two_rings(neighbours), fits, wanted, centred, trust)


def smooth_fits_far(
    centres: NDArray[np.float32],
    pitch: float,
    radius: float,
    neighbours: NDArray[np.int32],
    near: SmoothedFits,
    wanted: NDArray[np.bool_],
) -> LensFits:
    """What lenses have `smooth_fits` together with those farther off: planes of many lenses come out as planes.

    Lenses count as far as those about them agree. Beside a depth edge they see a little of both sides, and err toward
    the other one together.
    """
    centred = np.ones(len(centres), np.float32)
    trust = np.minimum(near.agreed / _AGREED, 1) ** _STEEPNESS
    fits = near.fits
    for _ in range(_TURNS):
        fits = _together(centres, pitch, radius, distant_rings(neighbours), fits, wanted, centred, trust).fits
    return fits


def _together(
    centres: NDArray[np.float32],
    pitch: float,
    radius: float,
    rows: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.bool_],
    centred: NDArray[np.float32],
    trust: NDArray[np.float32],
) -> SmoothedFits:
    """As `smooth_fits`, with the lenses `rows` (n, m) of each, which count as far as they and it have `trust` (n,)."""
    sizes, errors, slant_errors, bent, agreed = (np.empty(len(centres), np.float32) for _ in range(5))
    slants = np.empty((len(centres), 2), np.float32)
    _pool(
        centres, pitch, radius, rows, fits.patch_size.astype(np.float32), fits.standard_error.astype(np.float32),
        fits.slant, fits.slant_error, wanted, centred, trust, sizes, errors, slants, slant_errors, bent, agreed,
    )  # fmt: skip
    return SmoothedFits(LensFits(sizes, errors, slants, slant_errors), bent, agreed)
