"""Numbers of a training that no configuration changes, and what hangs on a run's step.

A number is here if it has a meaning and is the same for every scene. What users may change is in
`SceneConfig`. Whoever changes a number raises the recipe of the scene (`recast.runs.sources`).
"Not tried" says that no comparison with another value is on record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from recast.reconstruction.config import SceneConfig
from recast.splats.gaussians import C0


@dataclass(frozen=True)
class InitialisationSettings:
    """From the log to the first Gaussians, sky masks and depths of the views."""

    # Which vehicles become actors.
    parked_us: int = 1_000_000
    """Least time between the labels of a parked vehicle, microseconds: in less, standing still
    cannot be told from moving slowly. Not tried."""
    parked_views: int = 3
    """Least number of views that show a parked vehicle well enough. Not tried."""
    parked_pixels: float = 16
    """Least width and height of its box in them, pixels. Not tried."""
    parked_points: int = 50
    """Least number of LiDAR points on it. Not tried."""

    # LiDAR.
    box_margin_m: float = 0.15
    """Points this far outside of a labelled box are the actor's, metres: labels are tight."""
    box_ground_m: float = 0.1
    """Points this little above the bottom of a box are ground, metres."""
    held_out_us: int = 20_000
    """Sweeps this near in time to a held-out image were taken together with it, microseconds."""
    depth_window_us: int = 350_000
    """Sweeps this near in time to a view give it depths, microseconds: three and a half turns of a
    10 Hz LiDAR. Not tried."""
    nearest_m: float = 1.0
    """Least depth of a point that a view sees, metres."""
    farthest_m: float = 100.0
    """Largest depth of such a point, metres."""
    hiding_px: int = 3
    """Nearer points hide those this many pixels away: LiDARs and cameras stand apart. Not tried."""
    colour_us: int = 160_000
    """A sweep takes its colours from images at most this far away in time, microseconds."""
    lidar_reach_px: int = 5
    """Pixels this near to a LiDAR return are no sky and need no plane sweep. Not tried."""
    most_depths: int = 12_000
    """Most LiDAR depths of a view that the loss compares, which bounds memory and time."""

    # First Gaussians.
    opacity: float = 0.3
    """Opacity of first Gaussians. Not tried."""
    width: float = 0.7
    """Standard deviation over the distance to the nearest three points. Not tried."""
    flatness: float = 0.3
    """Thickness over width where points lie in a plane; a neighbourhood counts as flat if it is
    this much thinner than narrow. Not tried."""
    background_sigma_m: tuple[float, float] = (0.01, 3.0)
    """Least and largest standard deviation in the background, metres."""
    actor_sigma_m: tuple[float, float] = (0.01, 0.3)
    """The same for actors, metres."""
    fewest_actor_points: int = 200
    """With fewer points an actor also gets a grid on the faces of its box. Not tried."""
    grid_m: float = 0.15
    """Distance of the points of that grid, metres."""
    fewest_points: int = 100
    """With fewer points in view there is no street to train."""

    # Surfaces that no image shows. Chosen on `urban-straight` 51 and `suburban-curve` 52.
    unseen_sweeps: int = 3
    """Least number of sweeps that hit a voxel of which no image shows a point. Not tried."""
    unseen_sigma_m: float = 0.3
    """Largest standard deviation along a surface, metres: with 3 m they cover what is seen."""
    unseen_opacity: float = 0.95
    """Opacity of what no image shows. Not tried."""
    unseen_below_m: float = 0.3
    """Depth of the ground below even ground, metres. Gaussians are sorted by their centres: at 3 cm
    it shows through the road (1 dB), at 20 cm still (0.2 dB)."""
    unseen_colours: int = 8
    """Number of coloured points whose colours it gets. Not tried."""
    unseen_upright: float = 3.0
    """Factor of differences in height where these are looked for: a wall's foot is no road. Not
    tried."""
    unseen_share: float = 1 / 6
    """Share of the limit that each of both kinds may take. Not tried."""

    # Plane sweep (Collins 1996).
    sweep_stride: int = 3
    """Every n-th view of a camera is swept: its neighbours see nearly the same."""
    sweep_neighbours: tuple[int, ...] = (-2, -1, 1, 2)
    """Views that a view is compared with, in steps of time."""
    sweep_hypotheses: int = 48
    """Depths that are tried, evenly spaced in inverse depth."""
    sweep_range_m: tuple[float, float] = (5.0, 150.0)
    """Nearest and farthest of them, metres."""
    sweep_window_px: int = 7
    """Edge of the matching window, pixels."""
    sweep_most_cost: float = 0.06
    """Largest mean absolute difference (0 to 1) of an accepted pixel. Not tried."""
    sweep_least_ratio: float = 1.3
    """The best depth elsewhere must cost at least this many times the best one. Not tried."""
    sweep_least_texture: float = 0.02
    """Least standard deviation of grey (0 to 1) within the window. Not tried."""

    # Sky masks without a network.
    sky_least_bright: float = 0.62
    """Least value (0 to 1) of the brightest channel of sky. Not tried."""
    sky_least_blue: float = -0.02
    """Least blue less red (0 to 1): sunlit walls and leaves are as bright, but warm."""
    sky_largest_step: float = 0.12
    """Largest step of grey (0 to 1) between neighbouring pixels of sky. Not tried."""

    # How many Gaussians there may be. Trials on `arterial-median`, seed 71, 5 s, held-out PSNR.
    # Three cameras of 384x256, 1200 steps, Gaussians a square metre: 7: 28.5 dB, 14: 29.6, 27:
    # 30.3, 41 (all that growth asked for): 30.4. One camera of 192x128, 1000 steps, pixels a
    # Gaussian: 108: 28.2 dB, 54: 29.3, 27: 29.8, 14: 30.2.
    street_reach_m: float = 25.0
    """Street to either side of the drive that is counted, metres."""
    street_cell_m: float = 5.0
    """Edge of the cells in which it is counted, metres."""
    each_m2: float = 48.0
    """Gaussians per square metre of street: beyond the trials' knee."""
    pixels_each: float = 16.0
    """Pixels of the training images per Gaussian: the other knee."""
    least_limit: int = 20_000
    """Smallest limit that is derived."""
    first_share: float = 2 / 3
    """Share of the limit that the first points may take, so that growth always has room."""


@dataclass(frozen=True)
class OptimisationSettings:
    """From the first Gaussians to the trained scene.

    Decays are factors that a learning rate has at the end of the run, exponential in between. They
    are recast's own, for 1000 to 3000 steps; 3DGS decays centres alone, by 0.01.
    """

    # Learning rates.
    means_decay: float = 0.01
    scales_decay: float = 0.2
    opacities_decay: float = 0.3
    colours_decay: float = 0.3
    sky_decay: float = 0.1
    exposure_decay: float = 0.1
    deformation_decay: float = 0.01
    rest_rate: float = 0.05
    """View-dependent colour learns this much slower than the constant band (3DGS)."""
    poses_from: float = 0.1
    """Share of the run before poses are learned: Gaussians find their colours first."""
    poses_fall: float = 0.95
    """Share by which the rates of poses fall over the run, linearly."""
    radians_per_metre: float = 0.1
    """Learning rate of a camera's rotation, radians, over that of its translation, metres."""

    # Bounds.
    min_log_scale: float = -4.8
    """Logarithm of metres, 8 mm. Smaller Gaussians hide between the pixel centres of the training
    views and show elsewhere."""
    max_actor_log_scale: float = -1.2
    """Logarithm of metres, 30 cm. Larger ones would paint what lies outside of an actor's box."""
    colour_limit: float = 0.5 / C0
    """Keeps the constant colour in [0, 1]: below 0 the rasterizer's clamp kills the gradient."""

    # Deformable actors.
    rest_from: int = 3000
    """Steps that their canonical centres learn for, as in OmniRe, however short a run: they are
    where the LiDAR put them at first."""
    deforming_room: float = 1.5
    """Factor of a deformable actor's box, outside of whose projection nothing of it is seen."""

    # Losses.
    nearest_inverse_m: float = 0.5
    """Inverse depths are compared no nearer than this, metres: rays that meet nothing have 0."""
    sharpest: float = 10.0
    """Longest over shortest axis of a Gaussian that costs nothing (OmniRe)."""
    sharp_shape_every: int = 10
    """Steps between the costs of sharp shapes (OmniRe)."""
    smooth_over: int = 5
    """Track positions are compared with those up to this many labels before and after (OmniRe)."""

    # Density control.
    split_shrink: float = 1.6
    """The halves of a split Gaussian are this much smaller (3DGS)."""
    reset_opacity: float = 0.01
    """What a reset leaves of an opacity (3DGS)."""
    leave_box_m: float = 0.15
    """Centres may leave an actor's box by this, to the sides and upwards, metres: labels are
    tight."""
    leave_box_down_m: float = 0.05
    """The same downwards, metres: there is road."""

    # Even ground: left free, lane markings seen from the next lane fall into strips. Not tried.
    settle_every: int = 10
    """Steps between two moves of Gaussians onto it: in between they drift by millimetres."""
    ground_reach_m: float = 0.25
    """Gaussians farther above or below belong to something else, metres."""
    ground_thickness_m: float = 0.015
    """Most standard deviation across the sheet, metres."""


INIT = InitialisationSettings()
OPTIM = OptimisationSettings()


FLIPS, DEFORMATION = 1, 2
"""Streams of what a step sees mirrored, and of the first weights of the deformation network;
density control has the one without a number."""


def gaussian_rates(config: SceneConfig, u: float) -> dict[str, float]:
    """Learning rate of each field of the Gaussians; `sh` is that of the constant band."""
    return {
        "means": config.means_lr * OPTIM.means_decay**u,
        "quats": config.quats_lr,
        "log_scales": config.scales_lr * OPTIM.scales_decay**u,
        "logit_opacities": config.opacities_lr * OPTIM.opacities_decay**u,
        "sh": config.colours_lr * OPTIM.colours_decay**u,
    }


def pose_factor(u: float) -> float:
    """Factor on the learning rates of poses: none at first, then falling to a twentieth."""
    return 0.0 if u < OPTIM.poses_from else 1 - OPTIM.poses_fall * u


def coarse_factor(config: SceneConfig, u: float) -> int:
    """By how much width and height are divided: each factor has an equal part of the coarse run."""
    factors = config.coarse_factors
    if u >= config.coarse_fraction or not factors:
        return 1
    return factors[min(int(u / config.coarse_fraction * len(factors)), len(factors) - 1)]


@dataclass(frozen=True)
class DensitySchedule:
    """The steps of density control; all its spans are shares of the run, so they hold for any.

    recast's own recipe grows by a share of all Gaussians at a time and never resets opacities;
    that of 3DGS, which both published trainers follow, takes every row above the threshold and
    resets. Both are numbers of the configuration.

    Attributes:
        views: training images, by whose number a pause after a reset is measured.
    """

    config: SceneConfig
    views: int

    def goes_on(self, iteration: int) -> bool:
        """Whether the population may still change after this step (from 0)."""
        return iteration < self.config.densify_until * self.config.iterations

    def counts(self, iteration: int) -> bool:
        """Whether the screen-space gradients of this step (from 0) count.

        They count for the next change; where a pause leaves that out, they are of no use to a later
        one, as a reset made them what they are.
        """
        every = self.config.densify_every
        following = (iteration // every + 1) * every
        return self.goes_on(iteration) and not self._pauses(following)

    def counts_sizes(self, iteration: int) -> bool:
        """Whether absolute ones are needed for that."""
        measures = {self.config.densify_by, self.config.actor_densify_by}
        return self.counts(iteration) and measures != {"signed"}

    def changes(self, iteration: int) -> bool:
        """Whether the population changes when `iteration` steps are done."""
        config = self.config
        return (
            iteration % config.densify_every == 0
            and iteration >= config.densify_from * config.iterations
            and self.goes_on(iteration)
            and not self._pauses(iteration)
        )

    def resets(self, iteration: int) -> bool:
        """Whether opacities are reset when `iteration` steps are done; never at the very end."""
        period, steps = self._period(), self.config.iterations
        last = min(math.floor(self.config.opacity_reset_until * steps), steps - 1)
        return period > 0 and iteration % period == 0 and period <= iteration <= last

    def prunes_oversize(self, iteration: int) -> bool:
        """Whether there has been a reset before: until then large Gaussians may still shrink."""
        return 0 < self._period() < iteration

    def _pauses(self, iteration: int) -> bool:
        """Whether not every image was seen since the last reset (OmniRe's and gsplat's pause)."""
        if self.config.densify_pause == 0 or self._period() == 0:
            return False
        since = iteration % self._period()
        most = self.config.densify_pause * self._period()
        pause = min(max(self.views, self.config.densify_every), most)
        return 0 < since <= pause and self.resets(iteration - since)

    def _period(self) -> int:
        share = self.config.opacity_reset_every
        return max(1, round(share * self.config.iterations)) if share > 0 else 0


def generator(seed: int, iteration: int, *stream: int) -> torch.Generator:
    """Random numbers of one step, others for every `stream`."""
    words = np.random.SeedSequence([seed, iteration, *stream]).generate_state(1)
    return torch.Generator().manual_seed(int(words[0]))


def picked_view(seed: int, iteration: int, count: int) -> int:
    """The view of a step: each epoch visits every one of `count` once, in an order of its own."""
    epoch, position = divmod(iteration, count)
    return int(np.random.default_rng([seed, epoch]).permutation(count)[position])
