"""What a model with a history reads from its images, in metres, and foresees of it."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.dynamics import PACIFICA
from recast.planning.gtrs.config import GtrsConfig
from recast.planning.gtrs.scores import DEMONSTRATED
from recast.planning.types import WAYPOINTS

_DT = 0.1
ROAD_SCALES = (0.4, 0.06, 0.6, 1.5, 3.0)
"""Usual sizes of what is read of the road: metres beside the route, radians against it, and its
offsets `ROAD_AT` metres on."""
ROAD_AT = (10.0, 20.0, 30.0)
STANDS, MOVES = (1.0, 0.5, 1.0, 0.7), (5.0, 2.0)
"""The same of what a column shows: a road user (logit), the logarithm of its distance, cos and sin
of its heading; and its velocity against the ego ahead and to the left, m/s."""
COLUMN_SCALES = (*STANDS, *MOVES)
LOOKS_FROM = 1.5
"""Metres from the rear axle ahead to where distances are taken from."""
_LOOKS = torch.cat([torch.arange(1, WAYPOINTS, 2), torch.full((5,), WAYPOINTS - 1)])
_BEYOND = torch.cat([torch.zeros(WAYPOINTS // 2), 0.4 * torch.arange(1.0, 6.0)])
"""Waypoints at which the way is looked at, and seconds beyond the last one."""
_SPANS = ((0, 7), (7, 14), (14, 20), (20, 25))
"""Looks that belong together: to 1.4, 2.8, 4 and 6 s."""
_NEAR = ((0.2, 0.3), (0.7, 0.5), (2.0, 1.0))
"""Metres of a gap at which it counts by half, and over which it begins to count."""
_SOON = 1.5
"""Metres: a gap so much wider is as good as the vehicle's being e times less sure."""
_OFF = 3.0


class Foresight(nn.Module):
    """What is seen, in metres, and what each trajectory would come close to by it.

    Scores that follow from tokens alone need many samples until a car that stands is told from one
    that drives on. Here the image is read in metres: what stands in the direction of each column
    and how it moves, and where the road leads. Each trajectory is held against that, with all that
    moves going on at constant velocity, and what is found is added to its token. The readings are
    trained with the scores, see docs/train_the_small_planner.md.

    Args:
        channels: number of channels of all tokens, d.
        image_tokens: number of those of the image; the columns' follow them.
        columns: number of columns, W.
    """

    directions: Tensor

    def __init__(self, channels: int, image_tokens: int, columns: int) -> None:
        super().__init__()
        self._image_tokens = image_tokens
        self.stands, self.moves = nn.Linear(channels, len(STANDS)), nn.Linear(channels, len(MOVES))
        self.weigh = nn.Linear(channels, 4)
        self.read = nn.Sequential(
            nn.Linear(4 * channels, channels), nn.ReLU(), nn.Linear(channels, len(ROAD_SCALES))
        )
        found = len(_SPANS) * (len(_NEAR) + 5) + 2 * len(range(*DEMONSTRATED.indices(WAYPOINTS)))
        self.add = nn.Sequential(
            nn.Linear(found, channels), nn.ReLU(), nn.Linear(channels, channels)
        )
        self.register_buffer("directions", torch.zeros(columns))

    def columns(self, tokens: Tensor) -> Tensor:
        """Tokens (B, T, d), see `GtrsModel.look`, to what the columns show (B, W, 6), in units of
        `COLUMN_SCALES`."""
        there, moving = tokens[:, self._image_tokens :].chunk(2, dim=1)
        return torch.cat([self.stands(there), self.moves(moving)], dim=-1)

    def road(self, tokens: Tensor) -> Tensor:
        """Tokens (B, T, d) to where the road is (B, 5), in units of `ROAD_SCALES`."""
        image = tokens[:, : self._image_tokens]
        weights = self.weigh(image).softmax(dim=1)
        return self.read(torch.einsum("btq,btd->bqd", weights, image).flatten(1))

    def forward(self, tokens: Tensor, status: Tensor, trajectories: Tensor) -> Tensor:
        """What is added to the tokens of the trajectories, (B, L, d).

        Args:
            tokens: (B, T, d), see `GtrsModel.look`.
            status: (B, 8), see `ego_status`.
            trajectories: (N, L, 40, 3), N being 1 or B.
        """
        trajectories = trajectories.expand(len(tokens), -1, -1, -1)
        met = self._met(self.columns(tokens), status, trajectories)
        off = self._off(self.road(tokens) * tokens.new_tensor(ROAD_SCALES), trajectories)
        return self.add(torch.cat([met, off], dim=-1))

    def _met(self, seen: Tensor, status: Tensor, trajectories: Tensor) -> Tensor:
        """(B, L, F) what of that read (B, W, 6) each trajectory comes closest to, in four spans."""
        last = trajectories[:, :, -1]
        way = _BEYOND.to(last)[None, None, :, None] / _DT
        poses = trajectories[:, :, _LOOKS]  # (B, L, T, 3)
        onward = way * (last - trajectories[:, :, -2])[:, :, None, :2]
        poses = torch.cat([poses[..., :2] + onward, poses[..., 2:]], dim=-1)
        times = _DT * (_LOOKS.to(last) + 1.0) + _BEYOND.to(last)
        sure = functional.logsigmoid(seen[..., 0])
        distance, moves = metres(seen), seen[..., len(STANDS) :] * seen.new_tensor(MOVES)
        at = torch.stack([self.directions.cos(), self.directions.sin()], dim=-1)
        points = distance[..., None] * at + at.new_tensor([LOOKS_FROM, 0.0])  # (B, W, 2)
        moving = moves + torch.stack([status[:, 4], 0.0 * status[:, 4]], dim=-1)[:, None]
        with torch.no_grad():  # which one is closest; how close it is, is computed once more
            each = points[:, :, None] + times[:, None] * moving[:, :, None]  # (B, W, T, 2)
            gaps = _gaps(poses[:, :, None], each[:, None])[2]  # (B, L, W, T)
            worst = sure[:, None, :, None] - gaps.clamp(min=-1.0) / _SOON
        found, batch = [], torch.arange(len(seen), device=seen.device)[:, None]
        rows = torch.arange(poses.shape[1], device=seen.device)
        for begin, end in _SPANS:
            chosen = worst[..., begin:end].flatten(2).argmax(dim=-1)  # (B, L)
            column = torch.div(chosen, end - begin, rounding_mode="floor")
            look = begin + chosen % (end - begin)
            velocity = moving[batch, column]
            point = points[batch, column] + times[look][..., None] * velocity
            pose = poses[batch, rows, look]
            ahead, beside, gap = _gaps(pose, point)
            p = sure[batch, column].exp()
            found += [p * torch.sigmoid((half - gap) / over) for half, over in _NEAR]
            found += [
                p * (ahead / 10.0).clamp(-1.0, 3.0),
                p * (beside / 3.0).clamp(-1.0, 3.0),
                p * velocity[..., 0] / 10.0,
                p * velocity[..., 1] / 3.0,
                p,
            ]
        return torch.stack(found, dim=-1)

    def _off(self, road: Tensor, trajectories: Tensor) -> Tensor:
        """(B, L, F) how far trajectories are off the road (B, 5), to the left and either way."""
        x, y = trajectories[:, :, DEMONSTRATED, 0], trajectories[:, :, DEMONSTRATED, 1]
        heights = torch.cat([-road[:, :1], road[:, 2:]], dim=1)[:, :, None, None]
        y = y - heights[:, 0]
        for i in range(len(ROAD_AT)):
            start = ROAD_AT[i - 1] if i else 0.0
            share = (x - start) / (ROAD_AT[i] - start)
            share = share.clamp(min=0.0, max=1.0 if i + 1 < len(ROAD_AT) else 3.0)
            y = y - share * (heights[:, i + 1] - heights[:, i])
        off = torch.tanh(y / _OFF)
        return torch.cat([off, off.abs()], dim=-1)


def metres(found: Tensor) -> Tensor:
    """Distances (...) of what was read (..., >= 2), in units of `STANDS`; at most 90 m."""
    return (STANDS[1] * found[..., 1]).clamp(0.0, 4.5).exp()


def _gaps(poses: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Metres from the ego's box at poses (..., 3) to points (..., 2): beyond its ends, beyond its
    sides, and at all; negative within."""
    apart = points - poses[..., :2]
    cos, sin = poses[..., 2].cos(), poses[..., 2].sin()
    x = cos * apart[..., 0] + sin * apart[..., 1] - PACIFICA.centre_offset
    y = cos * apart[..., 1] - sin * apart[..., 0]
    ahead, beside = x.abs() - PACIFICA.length / 2, y.abs() - PACIFICA.width / 2
    outside = (ahead.clamp(min=0.0) ** 2 + beside.clamp(min=0.0) ** 2 + 1e-8).sqrt()
    gap = outside + torch.maximum(ahead, beside).clamp(max=0.0)
    return ahead, beside, gap


class PositionEmbedding(nn.Module):
    """One learned vector for each token. Not an `nn.Embedding`: on the meta device that imports a
    computer algebra system, which takes longer than all the rest of loading.
    """

    def __init__(self, tokens: int, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(tokens, channels))

    def forward(self, tokens: Tensor) -> Tensor:
        """(B, T, d) with the vectors added."""
        return tokens + self.weight


_NARROW = 32
"""Channels of an image token within a column."""
_FAST = 5.0
"""m/s, the usual size of what is compared."""
_CLEAR = 20.0
"""Metres up to which how much nearer something came says well how fast it comes: what is misread of
a distance grows with the distance."""


class ColumnTokens(nn.Module):
    """Two tokens for each column of image tokens: what stands in that direction, and how it moves.

    The first is made from each image alone, in the same way. The second is made from those of both
    images beside each other, and from how much nearer what stands there came, which is what motion
    is read from; it would take many samples until a network finds that by itself. That is carried
    past the layers that compare, too: nearly all cars that show their rear drive, and what they
    learn of that would outweigh what was measured.
    """

    def __init__(self, config: GtrsConfig) -> None:
        super().__init__()
        d, self._rows, self._history = config.channels, config.token_rows, config.history or 0.0
        self.narrow = nn.Linear(d, _NARROW)
        self.stack = nn.Sequential(
            nn.Conv1d(self._rows * _NARROW, d, 5, padding=2),
            nn.ReLU(),
            nn.Conv1d(d, d, 3, padding=1),
        )
        self.place = PositionEmbedding(config.token_columns, d)
        compared = 2 * d + 2 * len(STANDS) + 2
        self.compare = nn.Sequential(
            nn.Conv1d(compared, d, 5, padding=2), nn.ReLU(), nn.Conv1d(d, d, 3, padding=1)
        )
        self.carry = nn.Linear(2, d, bias=False)
        self.unknown = PositionEmbedding(config.token_columns, d)

    def forward(
        self,
        now: Tensor,
        earlier: Tensor | None,
        age: Tensor | None,
        stands: Callable[[Tensor], Tensor],
    ) -> Tensor:
        """Tokens (B, T, d) of two images, row by row, to (B, 2 W, d): what stands in the W columns,
        then how it moves.

        Args:
            earlier, age: see `GtrsModel.look`.
            stands: gives what is read (B, W, 4) from tokens (B, W, d), see `STANDS`.
        """
        seen = self._seen(now)
        moving = self.unknown(torch.zeros_like(seen))
        if earlier is not None:
            age = now.new_full((len(now),), self._history) if age is None else age.to(now)
            age = age[:, None, None]
            before = self._seen(earlier)
            seconds = torch.where(age > 0.0, age, torch.ones_like(age))
            here, there = stands(seen), stands(before)
            both = here[..., :1].sigmoid() * there[..., :1].sigmoid()
            far = metres(here)[..., None]
            came = both * (far - metres(there)[..., None]) / (seconds * _FAST)
            seconds = seconds.expand_as(came)
            parts = torch.cat([seen, before, here, there, came, seconds], dim=-1)
            compared = self.compare(parts.transpose(1, 2)).transpose(1, 2)
            carried = self.carry(torch.cat([came, came / (1.0 + (far / _CLEAR) ** 2)], dim=-1))
            moving = torch.where(age > 0.0, compared + carried, moving)
        return torch.cat([seen, moving], dim=1)

    def _seen(self, tokens: Tensor) -> Tensor:
        """(B, T, d) to (B, W, d)."""
        return self.place(self.stack(self._stacked(tokens).transpose(1, 2)).transpose(1, 2))

    def _stacked(self, tokens: Tensor) -> Tensor:
        """(B, T, d) to (B, W, rows x few): the rows of each column one after another, so that
        where a thing meets the road, and how tall it is, can be read off."""
        return self.narrow(tokens).unflatten(1, (self._rows, -1)).transpose(1, 2).flatten(2)
