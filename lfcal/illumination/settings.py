"""Tuned values of the illumination measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ..lattice.robust_fit import TUKEY_CUTOFF

__all__ = [
    "DEFAULT",
    "DEFECTS",
    "KERNEL",
    "LIGHTS",
    "LIGHT_KERNEL",
    "RIMS",
    "SAMPLE",
    "SCENE_PROFILE",
    "TYPE_PROFILES",
    "DefectSettings",
    "EstimateSettings",
    "KernelSettings",
    "LensLightSettings",
    "LightKernelSettings",
    "RimSettings",
    "SampleSettings",
    "SceneProfileSettings",
    "TypeProfileSettings",
]  # fmt: skip


@dataclass(frozen=True)
class EstimateSettings:
    """Tuned values of `estimate` and `measure`."""

    step: float = 0.25  # [px] between samples of the profile; a rim is about one pixel soft
    white_pixels: float = 2.5e5  # compared in one pass over a white image; the shape has a few hundred unknowns
    scene_pixels: float = 3e5  # the same of a scene capture
    profile_passes: int = 2  # over the profile alone, before it is accurate enough for the rest
    field_passes: int = 2  # that also fit what changes over direction and field
    profile_every: int = 4  # of the sampled lenses of a white image, in passes over the profile alone
    first_every: int = 2  # of the sampled lenses of a white image, in all other passes but the last
    white_core: float = 0.5  # [half the distance to the neighbour] radius in which the light of a lens is measured
    scene_core: float = 0.6  # the same in scene captures, whose content makes more pixels necessary
    clipped: float = 0.995  # [brightest luminance] of a scene capture from which on pixels count as clipped
    outlier: float = (
        TUKEY_CUTOFF  # [standard deviations] larger residuals are left out (the constant of Tukey's biweight)
    )
    harmonics: int = 12  # of the rim over the direction: squares and hexagons with their corners
    changing_harmonics: int = 3  # of them that may change over the field
    rim_degree: int = 2  # of the polynomials of the field for the rim
    shading_degree: int = 3  # of those for the shading
    significance: float = 4.0  # [standard errors] below it a block of terms is left out
    relevance: float = 0.02  # [px, RMS] by which a block of terms must move the rim
    average_lenses: int = 64  # whose mean is the vignetting of the average microimage


@dataclass(frozen=True)
class SampleSettings:
    """Tuned values of `sample`."""

    columns: int = 8  # most windows of the field across; enough for polynomials of the third degree
    rows: int = 6  # the same down
    window_lenses: int = 6  # least lenses a window should have; set by hand
    lens_pixels: int = 700  # needed of one lens; of larger ones rows and columns are left out
    lenses: int = 200  # least number of lenses in a sample


@dataclass(frozen=True)
class SceneProfileSettings:
    """Tuned values of `scene_profile`."""

    pixels: float = 1e6  # summed: scenes have more contrast than white images have noise
    core: float = 0.6  # [radius] within which the profile is 1 on the average
    darkest: float = 0.02  # [mean over windows] darker windows of the field are left out
    middle: float = 1.5  # [px] from the centre within which the profile is constant; a pixel blurs as much
    shrinkage: float = 2.0  # [standard errors] departures from 1 below it become 1


@dataclass(frozen=True)
class TypeProfileSettings:
    """Tuned values of `type_profiles`."""

    pixels: float = 6e6  # summed: all of a small flat, as scenes differ from lens to lens
    core: float = 0.5  # [usable radius] in which types are alike: blur of rims does not reach there
    darkest: float = 0.02  # [mean over windows] darker windows of the field are left out
    fewest_windows: int = 4  # of the field, for an error to be told from their scatter
    middle: float = 1.5  # [px] from the centre within which light is constant; a pixel blurs as much
    smooth: float = 1.25  # [px] over which the light of types is averaged; rims are softer
    shrinkage: float = 2.0  # [standard errors] differences below it become 0
    largest: float = 2.0  # factor between the light of a type and the mean of all that rims may reach
    distinct: float = 0.005  # difference of the light before the rims of types on white images, to order them
    relevance: float = 0.005  # largest difference from which on types count: half a level of a mid-grey byte


@dataclass(frozen=True)
class LensLightSettings:
    """Tuned values of `lens_light`."""

    samples: int = 48  # pixels read of a lens
    many_lenses: int = 1_000_000  # from so many lenses on fewer pixels are read of each
    few_samples: int = 12  # so many then
    row_preference: float = 1.5  # rows are skipped so many times as often as pixels of them, which lie side by side
    band: int = 128  # [rows] read at a time from a flat that is not in memory
    fitted_lenses: int = 4000  # that the polynomial of the field is fitted to
    typical_lenses: int = 20_000  # that medians over lenses are taken of
    degree_step: int = 2  # between the degrees of the polynomial that are tried in turn
    largest_degree: int = 6  # of them
    improvement: float = 0.03  # [share] by which a higher degree must lower the scatter of the lenses
    outlier: float = TUKEY_CUTOFF  # [standard deviations] of Tukey's biweight
    significance: float = 5.0  # [standard errors] by which a lens must differ from the polynomial
    difference: float = 0.01  # [light] and by so much
    unevenness: float = 1.6  # [noise] pixels of an evenly lit lens scatter by less: three standard errors of it
    own_scatter: float = 0.003  # [light] lenses that scatter by less may do so by errors of the model
    unlit: float = 0.03  # [brightest lenses] below it a lens has no light
    dim: float = 0.25  # the same for lenses that do not look like a microimage
    least_correlation: float = 0.5  # with the shape of microimages, of dim lenses
    least_correlation_bright: float = 0.25  # of any lens
    least_contrast: float = 0.1  # of the shape, for that correlation to mean anything
    missing: float = 0.05  # [least mean of its neighbours] a lens of a scene with no brighter pixel is missing


@dataclass(frozen=True)
class DefectSettings:
    """Tuned values of `defect_search`."""

    levels: int = 32  # of light, at each of which the noise is measured
    sample: int = 1_000_000  # pixels that it is measured on
    least_residual: float = 0.005  # [root of the brightest light] least scale: smaller residuals harm no picture
    least_mean: float = 0.015  # [root of the brightest light] the same of means over squares: lenses differ by as much
    significance: float = 6.0  # [standard deviations] beyond what Gaussian noise reaches in a flat
    clip: float = 3.0  # [standard deviations] most that a single pixel counts in a mean over several
    small_square: int = 3  # [px] side of the mean that shows specks too faint for single pixels
    large_square: int = 7  # [px] of another such mean
    local: float = 3.0  # [standard errors] by which the small mean must differ too where the large one does
    lenses: int = 36  # around, that a place is compared in: their scatter is known to a fifth
    lens_step: int = 3  # [lenses] from one of them to the next: dust may cover some beside each other; at 2, none of
    # a speck of 2.5 pitches is found, at 4, five times as many false ones on half-lit circles
    chunk: int = 20_000  # [px] compared at a time, so that memory does not grow with the flat


class KernelSettings(NamedTuple):
    """Values that the kernels of `residuals` and `scene_profile` are compiled with."""

    directions: int = 48  # bins of the direction
    contrast: float = 0.06  # beside a plane, at which a lens of a scene counts half
    clipped_share: int = 20  # a lens with more than one in so many pixels clipped is left out
    least_core_light: float = 0.5  # [light] of pixels that the light of a lens is measured in
    least_slope: float = 0.02  # [light per radius] of pixels that count for the rim
    least_shaded_light: float = 0.7  # [light] of pixels that count for the shading
    least_uncut: float = 0.95  # [share not cut off] of pixels that count for the shading
    cut_off: float = 0.02  # [share not cut off] below it pixels show stray light alone


class LightKernelSettings(NamedTuple):
    """Values that the kernels of `lens_light` are compiled with."""

    most_pixels: int = 288  # room for the pixels of a lens: six times those read on the average
    most_across: int = 96  # [px] of one row of a lens: twice those read of a whole lens
    together: int = 8  # [px] copied at once where every pixel of a row is read
    rim_light: float = 0.8  # [light] pixels below it tell more of the place of a lens than of its light
    flat_variance: float = 1e-6  # [mean squared] below it single precision shows no variance


@dataclass(frozen=True)
class RimSettings:
    """Tuned values of `rim_fit`."""

    start_growths: tuple[float, ...] = (0.15, 0.35, 0.6)  # [disc radius] displacements in the corner to start from
    start_radii: tuple[float, ...] = (1.0, 1.1, 1.25)  # [disc radius]
    start_shares: tuple[float, ...] = (0.0, 0.4)  # part of the displacement that the lattice may have absorbed
    passes: int = 12  # of Levenberg-Marquardt
    difference: float = 1e-3  # [px] of numerical derivatives
    converged: float = 1e-4  # relative fall of the squares that ends the fit
    # [px] where two rims cross, blur takes light from both: times log(2), for edges blurred by half a pixel together.
    crossing: float = 0.22
    distinct: float = 0.1  # share of the residual by which two solutions must differ to count as two
    explained: float = 0.8  # share of the variance of the rim that a cut must explain
    least_effect: float = 0.05  # [px, RMS] and how much of it


DEFAULT = EstimateSettings()
SAMPLE = SampleSettings()
SCENE_PROFILE = SceneProfileSettings()
TYPE_PROFILES = TypeProfileSettings()
LIGHTS = LensLightSettings()
RIMS = RimSettings()
DEFECTS = DefectSettings()
KERNEL = KernelSettings()
LIGHT_KERNEL = LightKernelSettings()
