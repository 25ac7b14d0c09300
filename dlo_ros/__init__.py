"""Watch, simulate and identify deformable linear objects (cables, ropes, hoses)."""

__version__ = "0.1.0"
