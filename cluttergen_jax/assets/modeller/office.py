"""The pool `office`: what is worked with at a desk."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import computing, organizers, paper, stationery

OFFICE = {
    "keyboard": computing.keyboard,
    "calculator": computing.calculator,
    "tape_dispenser": stationery.tape_dispenser,
    "scissors": stationery.scissors,
    "pen_holder": organizers.pen_holder,
    "desk_phone": computing.desk_phone,
    "letter_tray": organizers.letter_tray,
    "hole_punch": stationery.hole_punch,
    "sticky_notes": paper.sticky_notes,
    "ring_binder": paper.ring_binder,
}
