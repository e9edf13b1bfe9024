from .run import replicate as replicate

__all__ = ["replicate"]
