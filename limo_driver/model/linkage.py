"""JointLinkage: which joint moves each link, where some joints only follow others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.types import FloatArray, readonly

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True)
class JointLinkage:
    """How n joints move m links, of which each stands where one joint puts it.

        q_link = ratio q[driver] + offset

    Links come in the order of the tree, those that follow after those that they follow; so the
    first link of a joint is its own, and the joints are in the order of their own links.
    """

    driver: NDArray[np.int64]  # (m,), 0-based joint
    ratio: FloatArray  # (m,), 1 for the own link of a joint
    offset: FloatArray  # (m,) [rad, m]

    @classmethod
    def plain(cls, n: int) -> JointLinkage:
        """Return the linkage of n joints that move a link each."""
        return cls(_indices(range(n)), readonly(np.ones(n)), readonly(np.zeros(n)))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.driver.max(initial=-1)) + 1

    @property
    def links(self) -> int:
        """Number of links that move."""
        return self.driver.size

    @property
    def is_plain(self) -> bool:
        """Whether each joint moves a link, and none follows another."""
        return self.n == self.links

    @property
    def own(self) -> NDArray[np.int64]:
        """The own link of each joint, (n,)."""
        return np.unique(self.driver, return_index=True)[1]

    def positions(self, position: FloatArray) -> FloatArray:
        """Return the position of each link's joint, (..., m) [rad, m], of those of joints."""
        return position if self.is_plain else self.ratio * position[..., self.driver] + self.offset

    def rates(self, rate: FloatArray) -> FloatArray:
        """Return velocities or accelerations of each link's joint, (..., m), of those of joints."""
        return rate if self.is_plain else self.ratio * rate[..., self.driver]

    def torques(self, torque: FloatArray) -> FloatArray:
        """Return the torque of each joint, (..., n) [N m], of those about each link's own axis."""
        if self.is_plain:
            return torque
        summed = np.zeros((*torque.shape[:-1], self.n))
        for link, joint in enumerate(self.driver.tolist()):
            summed[..., joint] += self.ratio[link] * torque[..., link]
        return summed

    def felt_by(self, link: int) -> int:
        """Return how many joints, from the first on, can feel what moves with a link."""
        return int(self.driver[: link + 1].max()) + 1


def linkage_of(
    names: Sequence[str], followed: Mapping[str, tuple[str, float, float]]
) -> JointLinkage:
    """Return the linkage of links that are named by the joints of their own.

    Args:
        names: Of the joints of m links, each after the one that it follows.
        followed: Of joints that follow others: which one, ratio and offset.
    """
    joints = [name for name in names if name not in followed]
    drives = [followed.get(name, (name, 1.0, 0.0)) for name in names]
    return JointLinkage(
        _indices(joints.index(leader) for leader, _, _ in drives),
        readonly(np.array([ratio for _, ratio, _ in drives])),
        readonly(np.array([offset for _, _, offset in drives])),
    )


def _indices(values: Iterable[int]) -> NDArray[np.int64]:
    array = np.array(list(values), dtype=np.int64)
    array.flags.writeable = False
    return array
