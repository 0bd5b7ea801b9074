import numpy as np

from lfcal import Lattice
from lfrender.neighbours import neighbour_rows
from lfrender.radiance import GrayFlat
from lfrender.refinement import fit_pairs
from lfrender.slant import fit_lenses

SIZE = (420, 380)


def drawn_flat(patch_size, slant=(0.0, 0.0), noise=0.0, detail=1.3, basis=((23.2, 0.4), (11.25, 20.3)), seed=5):
    """A flat drawn from waves in scene coordinates: exact at every pixel, with `s` and its slant at the middle lens.

    Waves reach `detail` radians per flat pixel. A plane has 1 / s linear in X (GEOMETRY.md: M is the virtual depth).
    """
    rng = np.random.default_rng(seed)
    lattice = Lattice((200.3, 180.7), basis, SIZE, 11.2)
    pitch = lattice.pitch
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    index = np.rint(lattice.to_index(points))
    own = lattice.origin + index @ lattice.basis
    middle = np.array(SIZE) / 2
    # s of a lens at c, and s(delta) = s(c) + g(c) . delta within it, with g = D * grad(1/s) * s.
    tilt = np.asarray(slant) / (pitch * patch_size)
    at = 1 / (1 / patch_size + (own - middle) @ tilt)
    delta = points - own
    s = at + pitch * at * (delta @ tilt)
    scene = own - delta * (pitch / s)[:, None]
    image = np.zeros(len(points))
    for _ in range(60):
        wave = rng.uniform(-1, 1, 2) * detail * abs(patch_size) / pitch
        image += np.cos(scene @ wave + rng.uniform(0, 2 * np.pi))
    image = 0.5 + 0.02 * image + noise * rng.standard_normal(len(points))
    centres = lattice.centres()
    truth = 1 / (1 / patch_size + (centres - middle) @ tilt)
    gray = GrayFlat(image.reshape(y.shape).astype(np.float32), centres.astype(np.float32), 10.2, pitch)
    inner = np.all((centres > 2 * pitch) & (centres < np.array(SIZE) - 2 * pitch), axis=1)
    return gray, lattice, truth, inner


def measure(gray, lattice, start):
    rows = neighbour_rows(lattice, lattice.steps)
    half = rows.shape[1] // 2
    scale = np.full(len(start), 0.1, np.float32)
    pairs = fit_pairs(gray, rows[:, :half], start.astype(np.float32), scale, 8)
    return pairs, fit_lenses(gray, rows[:, :half], rows[:, half:], pairs, start.astype(np.float32))


def test_pairs_of_a_plane_have_no_common_error_at_any_fraction_of_a_pixel():
    for s in (-6.13, -5.37, 5.31, 6.84):
        gray, lattice, truth, inner = drawn_flat(s)
        pairs, _ = measure(gray, lattice, truth + 0.4)
        error = np.nanmedian(pairs.patch_size[inner, :, 0] - s, axis=0)
        assert np.abs(error).max() < 0.005, f"{s} px: off by {error} px along the lattice directions"


def test_each_lens_of_a_slanted_plane_answers_for_its_own_centre():
    gray, lattice, truth, inner = drawn_flat(-6.5, slant=(0.03, -0.02))
    assert np.ptp(truth[inner]) > 1.5
    _, lenses = measure(gray, lattice, truth + 0.3)
    error = np.abs(lenses.patch_size - truth)[inner]
    assert np.median(error) < 0.004
    assert np.quantile(error, 0.95) < 0.03
    at = np.argmin(np.abs(gray.centres - np.array(SIZE) / 2).sum(1))
    np.testing.assert_allclose(lenses.slant[at], (0.03, -0.02), atol=0.003)


def test_two_thirds_of_the_lenses_lie_within_their_standard_error():
    for noise in (0.01, 0.03):
        gray, lattice, truth, inner = drawn_flat(-6.5, noise=noise, detail=0.8)
        _, lenses = measure(gray, lattice, truth)
        within = (np.abs(lenses.patch_size - truth) < lenses.standard_error)[inner].mean()
        assert 0.58 < within < 0.8, f"noise {noise}: {within:.2f}"


def test_neighbours_on_two_surfaces_are_fitted_from_both_sides():
    gray, lattice, _truth, inner = drawn_flat(-6.0)
    start = np.where(gray.centres[:, 0] < 200, -6.0, 6.0).astype(np.float32)
    pairs, _ = measure(gray, lattice, start)
    across = neighbour_rows(lattice, lattice.steps)[:, 0]
    edge = inner & (start < 0) & (start[across] > 0)
    assert edge.sum() >= 8
    assert np.abs(pairs.patch_size[edge, 0, 0] + 6.0).max() < 0.05
    assert not (pairs.patch_size[edge, 0, 1] < 0).any()


def test_lenses_without_a_first_value_are_left_alone():
    gray, lattice, truth, inner = drawn_flat(5.0)
    start = np.where(np.arange(len(truth)) % 2, truth, np.nan)
    _, lenses = measure(gray, lattice, start)
    assert np.isnan(lenses.patch_size[::2]).all()
    assert np.isinf(lenses.standard_error[::2]).all()
    assert np.isfinite(lenses.patch_size[1::2][inner[1::2]]).all()
