"""Settings of the default tracker: its effort, and its tuned numbers with unit and effect."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PairSettings:
    """Tuned numbers of the fit of the marker pairs.

    Attributes
    ----------
    reach: distance outside an edge up to which pixels are read, where sizes are fitted [standard
        deviations of the edge]
    close: the same where only places are fitted
    nearly: last step above which a fit did not converge [px]
    uneven_steps: largest number of steps with uneven light
    first_blur: blur of the first fit, standard deviation [px]
    near: number of neighbours that the slope of the light follows from
    overlapping: number of neighbours at rest that may come to lie on a pair
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
    """Tuned numbers of the fit of colours, blur and black.

    Attributes
    ----------
    wider: factor by which an edge is tried wider or narrower
    widest: largest width of an edge, and inverse of the smallest, over that at rest
    rounds: number of rounds in which colours and places are fitted in turns
    blacks: tried levels of black [grey levels]; levels next to 0 would be taken for a dye's light
    faded: share of its contrast at rest below which a dye cannot be fitted
    palette_error: deviation of the share of light that a dye of the palette absorbs
    own_errors: weight of an image compared with the palette, over that of its noise alone: errors
        of the model are common to all pixels
    odd: residual of a pair over the median above which it weighs less: at the rim, where the ground
        is uncertain, a few would decide the colours of all
    """

    wider: float = 1.15
    widest: float = 4.0
    rounds: int = 2
    blacks: tuple[float, ...] = (-32.0, -16.0, 0.0, *(16.0 + 8.0 * k for k in range(14)))
    faded: float = 0.15
    palette_error: float = 0.03
    own_errors: float = 1.0 / 300.0
    odd: float = 2.0


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """Tuned numbers of the fit to the rest frames.

    Attributes
    ----------
    steps: largest number of steps of the first fit
    arrived: step of an edge below which a pair has converged [px]
    worse: median misfit above which colours and blur are fitted, so far below that of later frames
        that no noise lifts one of them above it
    unexplained: median misfit above which the shapes are no discs, or the noise is larger
    noisiest: largest noise that is assumed then [grey levels]
    no_light: share of the typical light below which a pair without a fit is no marker
    odd_size: deviation of the log size above which it is none
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
class LookSettings:
    """Tuned numbers of the judgement of a fit; distances are in pitches of the markers.

    Attributes
    ----------
    torn: difference between displacements of neighbours, or layers, above which they are torn off
    went_on: distance from its expected place below which a marker was not confused
    aside: distance from the place that the other layer shows, above which a marker on another one
        may be confused with it [radii]
    turns: number of frames in which each lost pair is examined once
    moved: displacement above which pairs show how far one layer moves with the other
    """

    torn: float = 0.4
    went_on: float = 0.2
    aside: float = 0.2
    turns: int = 4
    moved: float = 0.1


@dataclass(frozen=True, kw_only=True)
class RelocationSettings:
    """Tuned numbers of the detection without the last frame; distances are in pitches.

    Attributes
    ----------
    block: side of the blocks in which the light is measured
    ground_share: share of a block's pixels that certainly is ground
    smallest, largest: bounds of the area of a blob over that at rest
    reach: distance from the predicted place above which a blob is another marker
    certain: distance below which a blob is certain
    nearly: ratio of the distances of the second and the first blob above which it is certain, too
    around: number of neighbours that predict the place of a marker
    stiff: weight of the prior of no slope in the neighbours' displacement [px]
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
    """Tuned numbers for the detection of lossy compression, and for its errors.

    Attributes
    ----------
    blocks: number of blocks that are examined, the flattest ones at rest
    darkest, brightest: levels that the camera does not clip
    rounding: noise that rounding and the steps of a smooth shade count as [grey levels]
    different: residuals at the markers over the fine noise next to them, above which a picture was
        compressed; noise alone gives 1.2, the smallest loss that matters 4
    white: share of the coarse noise of colour above which the fine one shows no compression
    present: fine noise below which its kind is unknown [grey levels]
    least: error of the inner layer over the stated deviation, where most of the noise was kept
    smoothed: share added where all noise of brightness was removed
    most_noise: fine noise of brightness over the residuals, where most of it was kept
    coarse: residuals above which the quantisation was coarse [grey levels]
    moved: motion at which half of the error's variance is reached [px]
    shares: errors of (x, y, log size) of each layer over those of the inner layer's place
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
    """Settings of `MarkerTracker`: effort of a frame, and tuned numbers.

    Attributes
    ----------
    rows: distance between the rows of the image that are read
    limit: motion of an edge after which the template of its pair is computed again [px]
    steps: largest number of steps of a fit to a frame
    worse: factor on the median misfit above which colours and blur are fitted, too
    better: share of the misfit below which such a fit helped
    patience: frames between two such fits, while these change nothing
    few, few_share: newly lost markers, and share of all, above which all are detected again
    lost: misfit of a pair over the typical one, above which it is no marker
    worst: largest typical misfit that counts
    touching_size: deviation added to the log size of a marker that touches another of its layer
    pairs, tuning, rest, looks, relocation, compression: parts of the method
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
    looks: LookSettings = LookSettings()
    relocation: RelocationSettings = RelocationSettings()
    compression: CompressionSettings = CompressionSettings()
