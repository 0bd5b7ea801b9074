"""Simulated focused plenoptic cameras with known truth: rays are traced, no rendering formula is
called.

>>> from data_synth import SCENES, Camera, simulate
>>> camera = Camera.design(size=(120, 90), pitch=20)
>>> capture = simulate(SCENES["blank"](camera), camera, samples=1)
>>> capture.flat.shape
(90, 120, 3)
"""

from .boards import BoardShoot, shoot_board
from .camera import Camera
from .capture import Capture, Truth, load_capture
from .scenes import SCENES
from .simulator import simulate
from .surfaces import Patch, Scene, Sphere, box

__all__ = [
    "SCENES",
    "BoardShoot",
    "Camera",
    "Capture",
    "Patch",
    "Scene",
    "Sphere",
    "Truth",
    "box",
    "load_capture",
    "shoot_board",
    "simulate",
]
