"""The pool `study`: what stands about on a study's desk."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import computing, curios, gadgets, lamps, organizers, paper, stationery

STUDY = {
    "hardback_book": paper.hardback_book,
    "desk_lamp": lamps.desk_lamp,
    "alarm_clock": gadgets.alarm_clock,
    "camera": gadgets.camera,
    "globe": curios.globe,
    "laptop": computing.laptop,
    "mouse": computing.mouse,
    "stapler": stationery.stapler,
    "eyeglasses": curios.eyeglasses,
    "pencil_cup": organizers.pencil_cup,
}
