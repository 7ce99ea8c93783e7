"""An endless stream of rendered actuators with exact truth, every one another: what a network is pretrained on.

    sample = draw(seed=1, index=0)          an image, its midline, keypoints, visibility and angle
    look = drawn_look(1, size_wh=(640, 480), families=HELD_OUT)
    stage = Renderer(look)                     one look, for a video
    samples = [stage.frame(bend) for bend in inflation_deg(look, 100)]
    sample = draw(seed=1, index=0, kinds=KINDS)     the same actuator with extras: what real footage shows besides

Words that looks are drawn from. The two columns never mix, in any of the four families: a look that is held out
has a material, a background, a shape and a clamp that pretraining has not seen.

    family       training                                                              held out
    materials    translucent white, white, pigmented, dark rubber, printed, fabric,    tinted translucent, speckled
                 graded from one colour to another, banded
    backgrounds  plain, lined and squared paper, dark bench, wood, cutting mat,        optical table, curtain
                 breadboard, room, studio, cluttered bench, collage
    shapes       separated, fast and smooth chambers, bellows, fibre tube, PneuFlex,   sawtooth, knuckled
                 flat strip, ribbed tentacle
    clamps       block, vice, printed holder, clip, fingers                            pipe, boss head

Extras (`KINDS`) come on top of looks of the training words, and never of held-out ones: wrinkled silicone, rounded,
frayed and taped tips, zip ties, thick tubes, bare metal, ruled paper, tape glare, two-armed bodies that the edge cuts.
They are drawn from generators of their own. Without any, and in films, a look is what it was before.
"""

from .chain import KEYPOINTS
from .disturbances import Cable, Disturbances, Hand, Tube
from .drawing import draw
from .extras import KINDS, Extras
from .families import HELD_OUT, TRAINING, Families, Words
from .look import Look
from .look_sampling import before_other_background, drawn_look, in_other_light
from .renderer import Renderer, Sample, inflation_deg

__all__ = [
    "HELD_OUT",
    "KEYPOINTS",
    "KINDS",
    "TRAINING",
    "Cable",
    "Disturbances",
    "Extras",
    "Families",
    "Hand",
    "Look",
    "Renderer",
    "Sample",
    "Tube",
    "Words",
    "before_other_background",
    "draw",
    "drawn_look",
    "in_other_light",
    "inflation_deg",
]
