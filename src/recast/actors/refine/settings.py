"""Numbers of the refinement, with units and origins.

They were chosen on two synthetic drives, urban-straight 11 and underpass 13, and those that say so
on urban-straight 41; docs/actors.md has the tables. Where no comparison is named, none is on
record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Steps:
    """How long the descents are.

    Attributes:
        shape: steps of the whole body.
        paint: steps of the colours alone, with which the second descent begins.
        free: steps of every Gaussian after that, at most; with the rates of `RefinementSettings`
            chosen among 400 to 1200 on a vehicle of urban-straight 41 and KITTI's parked track 2.
        look_every: steps between looks at the held-back images.
        patience: looks without a better loss after which the second descent ends.
    """

    shape: int = 80
    paint: int = 60
    free: int = 500
    look_every: int = 50
    patience: int = 4


@dataclass(frozen=True)
class RefinementSettings:
    """What refinement minimises, and how far it lets a vehicle go."""

    # Images.
    least_images: int = 5
    """Fewer images than this cannot both teach and judge."""
    hold_back: int = 10
    """One image of so many is held back."""
    ssim_weight: float = 0.2
    """Weight of SSIM in the colour loss; the rest is L1 (3DGS)."""
    outline_weight: float = 0.5
    """Weight of the outline loss over that of colours."""
    edge_px: int = 2
    """Pixels on either side of a mask's border where it says little."""
    border_weight: float = 0.2
    """Weight of the outline there. With 0, and 0.2 within the mask, nothing is gained."""
    beside_px: int = 3
    """Pixels around a mask where colours are compared."""
    mirror_chance: float = 0.35
    """Probability that a step compares the mirrored vehicle. Without it, the logged views gain
    0.5 dB and the others lose 0.3 dB."""
    mirror_weight: float = 0.5
    """Weight of such a step."""

    # Both descents.
    rate_fall: float = 0.1
    """Factor of all learning rates at the end of a descent."""
    strain_weight: float = 0.002
    """Weight of the pull of lattice and poses towards zero."""
    pose_rate: float = 1e-3
    """Learning rate of the track's pose offsets, metres and radians."""
    free_pose_share: float = 0.3
    """Factor of that rate while every Gaussian moves: the first descent has found the poses."""

    # The whole body.
    move_rate: float = 4e-3
    """Learning rate of the place, metres."""
    turn_rate: float = 1e-3
    """Learning rate of the heading, radians."""
    grow_rate: float = 2e-3
    """Learning rate of the size, logarithm."""
    offsets_rate: float = 2e-3
    """Learning rate of the lattice's offsets, metres."""
    lidar_weight: float = 0.03
    """Weight of the distances of LiDAR points."""
    lidar_points: int = 1500
    """LiDAR points that count, at most."""
    lidar_noise_m: float = 0.04
    """Distance of a LiDAR point from the surface that costs as its noise, metres."""
    nearest_every: int = 15
    """Steps between searches for the nearest points of the surface."""
    lattice: tuple[int, int, int] = (6, 3, 4)
    """Nodes of the lattice: along, from the middle to a side, up."""
    lattice_room: float = 1.1
    """Size of the lattice over that of the box."""
    bend_m: float = 0.04
    """Offset of a node that costs 1, metres."""
    bend_step_m: float = 0.02
    """Difference between neighbouring nodes that costs 1, metres."""
    grow_spread: float = 0.05
    """Change of size that costs 1, logarithm."""
    knot_us: int = 400_000
    """Time between the knots of the pose offsets, microseconds."""
    pose_spread: tuple[float, float, float, float] = (0.03, 0.03, 0.015, 0.005)
    """Offsets forward, left and up (metres) and yaw (radians) that cost 1; half of it between
    neighbouring knots."""

    # Every Gaussian.
    means_rate: float = 2.5e-3
    quats_rate: float = 5e-3
    scales_rate: float = 1.5e-2
    opacities_rate: float = 7.5e-2
    colours_rate: float = 1.5e-2
    size_m: tuple[float, float] = (0.006, 0.25)
    """Least and largest standard deviation, metres."""
    shift_m: float = 0.05
    """Shift from the prior that counts as 1, metres."""
    shift_weight: float = 0.02
    """Weight of the pull of shifts. Chosen with the next two and `seen_px` on a vehicle of
    urban-straight 41 and on KITTI's parked track 2, see docs/actors.md."""
    scale_weight: float = 0.005
    """Weight of the pull of log scales."""
    direction_weight: float = 0.02
    """Weight of the pull of colours that change with the direction."""
    split_from: float = 0.5
    """Known share of a Gaussian from which on it is cut in two."""
    finest_m: float = 0.012
    """Smaller ones are not cut, metres."""
    apart: float = 0.6
    """Distance of the halves from the middle, in deviations."""
    shorter: float = 0.65
    """Length of a half over that of the whole: 0.6^2 + 0.65^2 = 0.88^2 of the deviation is kept."""
    surface_opacity: float = 0.3
    """Opacity from which on a Gaussian counts as surface in the report."""

    # Its shadow.
    shadow_reach_m: float = 1.5
    """Ground around the box whose shadow follows the images, metres."""
    road_weight: float = 1.0
    """Weight of colours on the road over those on the vehicle."""
    dark: float = 0.02
    """Display value of a shadow at first."""
    densest: float = 2.0
    """Logit of the opacity of a Gaussian of the shadow, at most."""
    shade_rate: float = 0.1
    """Learning rate of the logits of its opacities."""
    shade_weight: float = 0.005
    """Weight of the pull of the shadow towards the one that sun and sky cast."""

    # How much of it was seen.
    patch_m: float = 0.06
    """Surface around a Gaussian that is seen or not seen together, metres."""
    patch_px: float = 1.5
    """Least size of a patch in the nearest image, pixels: less cannot be told apart. Found on
    KITTI's track 5, which is far off: without it the van is hardly free."""
    shown_px: float = 0.5
    """Pixels of a Gaussian's own over all images that put it in the picture."""
    drawn_px: float = 0.01
    """The same, below which the images are drawn without it."""
    seen_px: float = 4.0
    """Pixels of a patch over all images that make it two thirds seen; 200, 20 and 4 were
    compared."""
    neighbours: int = 8
    """Gaussians over which the freedom is smoothed."""
    mirrored_freedom: float = 0.6
    """Freedom of what only images of the other side show."""

    least_freedom: float = 0.02
    """With less, a Gaussian stays as it is."""

    # The paint of what nobody saw.
    known: float = 0.6
    """Share of images in a Gaussian that may lend its correction."""
    look: float = 0.08
    """Difference of display colour that counts as 1 between lender and borrower."""
    upright: float = 0.4
    """The same, of the share of "up" in the normal."""
    height_m: float = 0.5
    """The same, of the height, metres."""
    place_m: float = 3.0
    """The same, of the place along the vehicle, metres."""
    lenders: int = 32
    """Gaussians that lend to one, at most."""
    doubt: float = 2.0
    """Lenders' worth of evidence for no correction."""

    # What surrounds it.
    gains: tuple[float, float] = (0.8, 1.25)
    """Least and largest factor of an image's exposure."""
    gain_prior_px: float = 40.0
    """Pixels' worth of evidence for a gain of one."""
    road_reach_m: float = 3.0
    """Road around the box that is compared, metres."""
    road_pixels: int = 600
    """Pixels of an image that are compared, at most."""
    fewest_road_pixels: int = 10
    """With fewer, an image says nothing of the shadow."""
    clear: float = 0.9
    """Share of light that must pass what is nearer."""
    on_it: float = 0.02
    """Value of the mask from which on a pixel may show the vehicle itself."""
    black: float = 0.05
    """Display value that is added before a logarithm."""
    strongest: float = 1.2
    """Largest logarithm of a loss of light."""
    darkness: tuple[float, float] = (0.2, 1.3)
    """Least and largest factor of the contact shadow's opacity."""
    darkness_prior: float = 2.0
    """Weight of a factor of one, in pixels whose light the shadow takes altogether."""

    def shape_rates(self) -> dict[str, float]:
        """Learning rates of the first descent by parameter."""
        return {
            "move": self.move_rate,
            "turn": self.turn_rate,
            "grow": self.grow_rate,
            "offsets": self.offsets_rate,
            "poses": self.pose_rate,
        }

    def free_rates(self) -> dict[str, float]:
        """Learning rates of the second descent by parameter."""
        return {
            "means": self.means_rate,
            "quats": self.quats_rate,
            "log_scales": self.scales_rate,
            "logit_opacities": self.opacities_rate,
            "sh": self.colours_rate,
            "poses": self.free_pose_share * self.pose_rate,
            "shadow_sh": self.colours_rate,
            "shadow_logit_opacities": self.shade_rate,
        }

    @property
    def log_size(self) -> tuple[float, float]:
        """`size_m` as logarithms."""
        least, most = np.log(self.size_m)
        return float(least), float(most)


REFINE = RefinementSettings()
