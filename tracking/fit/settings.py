"""Settings of the default tracker: its effort, and its tuned parameters with unit and effect."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PairSettings:
    """Tuned parameters of the fit of the marker pairs.

    Attributes
    ----------
    reach: distance outside an edge up to which pixels are read when sizes are fitted [standard
        deviations of the edge]
    close: the same distance when only positions are fitted
    nearly: last step above which a fit did not converge [px]
    uneven_steps: largest number of steps with uneven light
    first_blur: blur of the first fit, standard deviation [px]
    near: number of neighbours from which the slope of the light is estimated
    overlapping: number of neighbours at rest that may later lie on a pair
    crowded: distance below which markers of a layer may be confused [radii]
    touching: distance below which markers touch [radii]; they take more and smaller steps
    beside: distance below which markers share the light between their edges [radii]
    touching_steps: largest number of further steps of pairs that touch
    smaller: factor on the last step of such pairs at which they have converged
    worse: factor on the misfit above which such steps are undone
    """

    reach: float = 3.0
    close: float = 2.0
    nearly: float = 0.3
    uneven_steps: int = 6
    first_blur: float = 0.8
    near: int = 6
    overlapping: int = 12
    crowded: float = 1.2
    touching: float = 2.1
    beside: float = 2.7
    touching_steps: int = 30
    smaller: float = 0.1
    worse: float = 1.1


@dataclass(frozen=True, kw_only=True)
class TuningSettings:
    """Tuned parameters of the fit of colours, blur and black level.

    Attributes
    ----------
    wider: factor by which an edge is tried wider or narrower
    widest: largest width of an edge, and inverse of the smallest, over that at rest
    closer, closer_turns: first such factor of a closer fit of the blur alone, and number of turns
    rounds: number of rounds in which colours and positions are fitted alternately
    blacks: black levels to try [grey levels]; levels near 0 could be confused with a dye's light
    faded: share of its contrast at rest below which a dye cannot be fitted
    palette_error: standard deviation of the share of light that a dye of the palette absorbs
    own_errors: weight of the image against the palette, over the weight that its noise alone would
        give; errors of the model are common to all pixels
    odd: residual of a pair over the median above which its weight is reduced; a few pairs at the
        rim, where the ground is uncertain, would else determine all colours
    """

    wider: float = 1.15
    widest: float = 4.0
    closer: float = 1.06
    closer_turns: int = 4
    rounds: int = 2
    blacks: tuple[float, ...] = (-32.0, -16.0, 0.0, *(16.0 + 8.0 * k for k in range(14)))
    faded: float = 0.15
    palette_error: float = 0.03
    own_errors: float = 1.0 / 300.0
    odd: float = 2.0


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """Tuned parameters of the fit to the rest frames.

    Attributes
    ----------
    steps: largest number of steps of the first fit
    arrived: motion of an edge in a step, below which a pair has converged [px]
    worse: median misfit above which colours and blur are fitted; below `FitSettings.worse`, so that
        noise alone does not cause this in a later frame
    unexplained: median misfit above which a larger noise is assumed, as shapes are no ideal discs
    noisiest: largest noise that is assumed then [grey levels]
    no_light: share of the typical light below which a pair without a fit is not a marker
    odd_size: deviation of the log size above which a pair without a fit is not a marker
    least_share: share of the pairs that must look like markers
    """

    steps: int = 24
    arrived: float = 0.05
    worse: float = 1.04
    unexplained: float = 4.0
    noisiest: float = 16.0
    no_light: float = 0.2
    odd_size: float = 0.4
    least_share: float = 0.7


@dataclass(frozen=True, kw_only=True)
class SkinSettings:
    """Tuned parameters of the light of an uneven skin; its deviations are those of logarithms.

    Attributes
    ----------
    worse: median misfit at rest above which the skin may be uneven
    uneven, scale: deviation of the logarithm of its light, in a tenth of the pixels between the
        markers, above which it is, and a scale of smoothing against noise [px]
    edges: standard deviation of the places of edges in each turn of light and shapes [px]
    scales: scales of smoothing, from coarse to fine [px]
    shared: deviations of brightness between two scales that are expected
    own: deviations of a single channel that are expected on top of it
    lost: misfit of a pair over the typical one, above which nothing is seen through it
    white: mean level above which a camera shows light as white
    rounding: variance of a mean level by rounding and coding [squared grey levels]
    least: smallest variance of the logarithm of a pixel's light
    error: error of a place over unevenness and motion since rest
    far: motion after which it hardly grows [standard deviations of an edge]
    """

    worse: float = 1.2
    uneven: float = 0.05
    scale: float = 1.5
    edges: tuple[float, ...] = (0.2, 0.03, 0.03, 0.03)
    scales: tuple[float, ...] = (16.0, 3.0, 0.7)
    shared: tuple[float, ...] = (2.0, 0.3, 0.05)
    own: tuple[float, ...] = (1.0, 0.1, 0.03)
    lost: float = 20.0
    white: float = 250.0
    rounding: float = 0.02
    least: float = 1e-5
    error: float = 0.35
    far: float = 5.0


@dataclass(frozen=True, kw_only=True)
class LookSettings:
    """Tuned parameters of the judgement of a fit; distances are in pitches of the markers.

    Attributes
    ----------
    torn: difference between displacements of neighbours, or of layers, above which a marker counts
        as torn off, that is probably confused with another one
    went_on: distance from its expected position below which a marker was not confused
    aside: distance from the position predicted by the other layer, above which a marker that lies
        on another one may be confused with it [radii]
    turns: number of frames in which each lost pair is examined once
    moved: displacement above which pairs show the ratio of both layers' displacements
    """

    torn: float = 0.4
    went_on: float = 0.2
    aside: float = 0.2
    turns: int = 4
    moved: float = 0.1


@dataclass(frozen=True, kw_only=True)
class RelocationSettings:
    """Tuned parameters of the detection without the previous frame; distances are in pitches.

    Attributes
    ----------
    block: side of the blocks in which the light is measured
    ground_share: share of a block's pixels that is certainly ground
    smallest, largest: bounds of the area of a blob over that at rest
    reach: largest distance of a blob from the predicted position of its marker
    certain: distance below which the assignment of a blob is certain
    nearly: ratio of the distances of the second and the first blob above which it is certain, too
    around: number of neighbours that predict the position of a marker
    stiff: weight of the prior that neighbours' displacements have no gradient [px]
    """

    block: float = 2.0
    ground_share: float = 0.3
    smallest: float = 0.4
    largest: float = 2.2
    reach: float = 0.45
    certain: float = 0.2
    nearly: float = 1.5
    around: int = 8
    stiff: float = 8.0


@dataclass(frozen=True, kw_only=True)
class CompressionSettings:
    """Tuned parameters of the detection of lossy compression, and of its errors.

    Attributes
    ----------
    blocks: number of examined blocks, the flattest ones at rest
    darkest, brightest: range of levels that the camera does not clip
    rounding: noise equivalent to rounding and to the steps of a smooth shade [grey levels]
    different: residuals at the markers over the fine noise next to them, above which a picture was
        compressed; noise alone gives 1.2, the smallest relevant compression 4
    white: fine over coarse colour noise, above which there is no compression
    present: fine colour noise below which this ratio is not used [grey levels]
    least: actual over stated standard deviation of the inner layer if most noise was kept
    smoothed: relative increase of `least` if all noise of brightness was removed
    most_noise: fine noise of brightness over the residuals if most noise was kept
    coarse: residuals above which the quantisation was coarse [grey levels]
    moved: motion at which half of the error's variance is reached [px]
    shares: errors of (x, y, log size) of each layer over the error of the inner layer's position
    """

    blocks: int = 256
    darkest: float = 8.0
    brightest: float = 247.0
    rounding: float = 0.5
    different: float = 2.5
    white: float = 0.8
    present: float = 0.4
    least: float = 2.9
    smoothed: float = 1.1
    most_noise: float = 0.26
    coarse: float = 6.3
    moved: float = 0.5
    shares: tuple[float, ...] = (0.55, 0.55, 0.45, 1.0, 1.0, 0.75)


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of `MarkerTracker`: effort per frame, and tuned parameters.

    Attributes
    ----------
    rows: distance between the rows of the image that are read
    limit: motion of an edge after which the template of its pair is computed again [px]
    steps: largest number of steps of a fit to a frame
    worse: factor on the median misfit above which colours and blur are fitted, too
    better: remaining share of the misfit below which such a fit helped
    patience: number of frames between two such fits while they do not help
    few, few_share: number of newly lost markers, and share of all, above which all are detected
        again
    lost: misfit of a pair over the typical one, above which it counts as lost
    worst: upper bound of the typical misfit in this comparison
    touching_size: standard deviation added to the log size of a marker that touches another one of
        its layer
    pairs, tuning, rest, skin, looks, relocation, compression: settings of the parts of the method
    """

    rows: int = 1
    limit: float = 0.07
    steps: int = 6
    worse: float = 1.1
    better: float = 0.98
    patience: int = 4
    few: int = 3
    few_share: float = 0.02
    lost: float = 6.0
    worst: float = 20.0
    touching_size: float = 0.003
    pairs: PairSettings = PairSettings()
    tuning: TuningSettings = TuningSettings()
    rest: RestSettings = RestSettings()
    skin: SkinSettings = SkinSettings()
    looks: LookSettings = LookSettings()
    relocation: RelocationSettings = RelocationSettings()
    compression: CompressionSettings = CompressionSettings()
