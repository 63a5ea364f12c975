"""The pool `household`: what is found about the house."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import bathroom, curios, gadgets, homeware, lamps

HOUSEHOLD = {
    "tissue_box": homeware.tissue_box,
    "tape_roll": homeware.tape_roll,
    "spray_bottle": bathroom.spray_bottle,
    "candle": lamps.candle,
    "flower_pot": homeware.flower_pot,
    "remote_control": gadgets.remote_control,
    "toy_car": curios.toy_car,
    "soap_dispenser": bathroom.soap_dispenser,
    "photo_frame": curios.photo_frame,
    "basket": homeware.basket,
}
