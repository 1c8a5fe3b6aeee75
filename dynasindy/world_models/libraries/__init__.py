"""Libraries of candidate functions: elementary functions, features as their products, and libraries by name."""

from dynasindy.world_models.libraries.named import (
    NAMED,
    LibraryBuilder,
    auto,
    build_library,
    dead_zone,
    fourier,
    friction,
    paper_equation,
    paper_table,
    polynomial,
    product_of,
    rotor,
    rotor_reaction,
    rotor_rig,
    sum_of,
    terms,
)

__all__ = [
    "NAMED",
    "LibraryBuilder",
    "auto",
    "build_library",
    "dead_zone",
    "fourier",
    "friction",
    "paper_equation",
    "paper_table",
    "polynomial",
    "product_of",
    "rotor",
    "rotor_reaction",
    "rotor_rig",
    "sum_of",
    "terms",
]
