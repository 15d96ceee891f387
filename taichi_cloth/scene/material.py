"""Materials of cloth: numbers that do not change when its grid is refined.

A grid of spacing h stands for a sheet in which a strip of width b, pulled by the force F, becomes
longer by the part F / (stretch b) of its length. A structural spring of length h stands for a strip
as wide as reaches half-way to the rows, or columns, beside it: b = h, at the cloth's edges h / 2.
So its stiffness is stretch b / h: the springs side by side have that of the strip, one after the
other that of its length, in any resolution. (van Gelder, "Approximate simulation of elastic
membranes by triangulated spring meshes", 1998, with squares in the place of triangles; Provot,
"Deformation constraints in a mass-spring model", 1995, has the grid.)

Of simple shear by the angle g a cell's two diagonals are longer and shorter by h g / sqrt 2. With
a stiffness of `shear` each they keep the energy shear g^2 / 2 on an area, in any resolution. They
resist stretching, too: pulled along its threads, a cloth with both resists as
stretch (stretch + 2 shear) / (stretch + shear), and becomes narrower.

`damping_time` is that of a Kelvin-Voigt solid: each dashpot is that time times its spring's
stiffness. `strength` is the pull on a width at which a strip tears: every spring breaks at the same
strain, strength / stretch.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.properties import NOT_NEGATIVE, POSITIVE, Rule
from taichi_cloth.settings import accepted

# What springs of these kinds have of the material, in the place of numbers of their own.
OF_MATERIAL = {"stiffness": "stretch", "damping": "damping_time", "break_force": "strength"}


@dataclass(frozen=True)
class Material:
    """The numbers of a cloth's material, each absent (None) where it is not given.

    density: mass of an area; thickness: of the cloth, twice the radius of its particles [length];
    stretch, shear: stiffness against stretching and shear [force / length]; damping_time: [time];
    strength: the pull on a width at which it tears [force / length].
    """

    density: float | None = None
    thickness: float | None = None
    stretch: float | None = None
    shear: float | None = None
    damping_time: float | None = None
    strength: float | None = None

    @classmethod
    def given(
        cls,
        what: str,
        material: Material | None,
        links: Collection[str],
        given: Mapping[str, Mapping[str, Any]],
    ) -> Material:
        """The material given of `what`, checked; None: none is."""
        of: Any = cls() if material is None else material
        if not isinstance(of, cls):
            raise InputError(f"{what}: material must be a Material, is {accepted.shown(of)}")
        return of if material is None else of.checked(links, given)

    def checked(self, links: Collection[str], given: Mapping[str, Mapping[str, Any]]) -> Material:
        """This material, if a cloth with these kinds of link can have it; else InputError.

        given: values of springs by kind, by name, that the cloth gives beside it.
        """
        numbers: dict[str, float | None] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                value = accepted.number(field.name, value)
                rule = RULES[field.name]
                if not rule.holds(value):
                    raise InputError(f"{field.name} {rule.says}, is {value:g}")
            numbers[field.name] = value
        if self.stretch is None:
            for name in ("shear", "damping_time", "strength"):
                if numbers[name] is not None:
                    raise InputError(f"{name} needs stretch, the material's stiffness, beside it")
            return Material(**numbers)
        if self.shear is not None and "shear" not in links:
            raise InputError("shear: this cloth has no shear links; add 'shear' to links")
        if self.shear is None and "shear" in links:
            raise InputError("stretch: shear links need shear, the material's, beside it")
        if self.strength is not None and not self.stretch > 0:
            raise InputError("strength needs a stretch above 0")
        if self.strength is not None and self.shear == 0:
            raise InputError("strength needs a shear above 0, or no shear links")
        for name, instead in OF_MATERIAL.items():
            if numbers[instead] is None:
                continue
            twice = sorted({"structural", "shear"} & set(given.get(name, {})))
            if twice:
                raise InputError(f"{name} is given by {instead} too; leave one of them")
        return Material(**numbers)

    def of_links(
        self, kind: str, width: np.ndarray, length: float | np.ndarray
    ) -> dict[str, np.ndarray]:
        """The material's numbers of links of a kind, (s,) each: stiffness and others, by name.

        width: of the strip that each structural one stands for, in spacings, (s,); length: theirs.
        """
        per_width = {"structural": self.stretch, "shear": self.shear}.get(kind)
        if self.stretch is None or per_width is None:
            return {}
        stiffness = per_width * (width if kind == "structural" else np.ones_like(width))
        found: dict[str, np.ndarray] = {"stiffness": stiffness}
        if self.damping_time is not None:
            found["damping"] = self.damping_time * stiffness
        if self.strength is not None:
            found["break_force"] = stiffness * length * (self.strength / self.stretch)
        return found


RULES: dict[str, Rule] = {
    "density": POSITIVE,
    "thickness": NOT_NEGATIVE,
    "stretch": NOT_NEGATIVE,
    "shear": NOT_NEGATIVE,
    "damping_time": NOT_NEGATIVE,
    "strength": POSITIVE,
}
KEYS = tuple(field.name for field in fields(Material))
