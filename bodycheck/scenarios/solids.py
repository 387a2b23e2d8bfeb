"""The solid of a command line, and its mass properties as TOML."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck.scenarios.level_sets import HALF_WIDTH, Estimate, estimate, estimate_level_set
from bodycheck.scenarios.mass_properties.implicit import ImplicitEllipsoid, ImplicitSolid, ImplicitTorus
from bodycheck.scenarios.mass_properties.solid import PRIMITIVES, MassProperties, Overlap
from bodycheck.scenarios.mesh_files import MESH_SUFFIXES
from bodycheck.scenarios.shapes import Unit, load_mesh, primitive
from bodycheck.scenarios.user_functions import user_function

_IMPLICIT: dict[str, Callable[..., ImplicitSolid]] = {"ellipsoid": ImplicitEllipsoid, "torus": ImplicitTorus}


@dataclass(frozen=True)
class SolidRequest:
    """The name of a mesh file, shape or package.module:function, and the options.

    density in kg/m^3, or None and the mass in kg. size: dimensions of a shape in m. box: around a function's
    solid, in m. monte_carlo: estimate a shape instead of computing it exactly. allow_code: allow importing a
    function. unit: of a mesh file's lengths. overlap: what to do with overlapping parts of a mesh.
    """

    name: str
    density: float | None
    size: Sequence[float] | None = None
    box: Sequence[float] | None = None
    monte_carlo: bool = False
    allow_code: bool = False
    unit: Unit | None = None
    overlap: Overlap | None = None
    mass: float | None = None


def mass_properties(request: SolidRequest) -> MassProperties | Estimate:
    """Return the mass properties of a mesh or a shape, exact to round-off, or an estimate for a function.

    Raises InputError with one line for an unknown name, for a missing or inapplicable option, and for an
    unusable solid.
    """
    name = request.name
    if (request.density is None) == (request.mass is None):
        raise InputError(f"{name}: give either --density-kg-m3 or --mass-kg")
    if Path(name).suffix.lower() in MESH_SUFFIXES or Path(name).is_file():
        _check_options(request, "a mesh file", size=False, box=False, mesh=True)
        return load_mesh(Path(name), request.density, request.unit, request.overlap, request.mass)
    if name in PRIMITIVES:
        _check_options(request, "a shape", size=True, box=False, monte_carlo=name in _IMPLICIT)
        exact = primitive(name, request.size or (), request.density, request.mass)
        return (
            _at_density(estimate(_IMPLICIT[name](*request.size or ())), request)
            if request.monte_carlo
            else exact
        )
    if ":" in name:
        _check_options(request, "a function", size=False, box=True)
        function = user_function(name, allow_code=request.allow_code)
        return _at_density(estimate_level_set(name, function, request.box or ()), request)
    raise InputError(
        f"{name}: is neither a mesh file ({', '.join(MESH_SUFFIXES)}), nor a shape "
        f"({', '.join(PRIMITIVES)}), nor a function (package.module:function)"
    )


def _at_density(found: Estimate, request: SolidRequest) -> Estimate:
    if request.density is None:
        raise InputError(f"{request.name}: an estimate requires --density-kg-m3, not --mass-kg")
    try:
        return found.at_density(request.density)
    except ValueError as error:
        raise InputError(f"{request.name}: {error}") from None


def _check_options(
    request: SolidRequest, what: str, *, size: bool, box: bool, mesh: bool = False, monte_carlo: bool = False
) -> None:
    """Refuse missing options, and those that would be silently ignored."""
    for option, value, expected in (("--size-m", request.size, size), ("--box-m", request.box, box)):
        if (value is not None) != expected:
            raise InputError(f"{request.name}: {what} {'requires' if expected else 'does not take'} {option}")
    for option, stated in (("--unit", request.unit), ("--overlap", request.overlap)):
        if stated is not None and not mesh:
            raise InputError(f"{request.name}: {option} is for mesh files, not for {what}")
    if request.monte_carlo and not monte_carlo:
        raise InputError(f"{request.name}: --monte-carlo is only for {', '.join(_IMPLICIT)}")


def as_toml(found: MassProperties | Estimate) -> Iterator[str]:
    """Yield the lines of [body], for use in a scenario, and of [solid], with the other results."""
    solid = found.properties if isinstance(found, Estimate) else found
    if isinstance(found, Estimate):
        yield "# estimated by randomised quasi-Monte Carlo; the standard error of each number is in [solid]:"
        yield f"# a 95 % interval is the number +- {HALF_WIDTH:.4g} standard errors"
    for note in solid.notes:
        yield f"# {note}"
    yield "[body]"
    yield f"mass_kg = {solid.mass!r}"
    yield "# about the centre of mass, in the solid's own axes"
    yield f"inertia_kg_m2 = {solid.inertia.tolist()}"
    yield ""
    yield "[solid]"
    yield f"centre_m = {solid.centre.tolist()}"
    if isinstance(found, Estimate):
        yield f"mass_standard_error_kg = {found.mass_error!r}"
        yield f"inertia_standard_error_kg_m2 = {found.inertia_error.tolist()}"
        yield f"centre_standard_error_m = {found.centre_error.tolist()}"
    else:
        moments, axes = solid.principal()
        yield f"principal_moments_kg_m2 = {moments.tolist()}"
        yield "# one axis per row, in the solid's own axes"
        yield f"principal_axes = {axes.T.tolist()}"
