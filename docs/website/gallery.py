"""What the gallery shows: commands, and the picture that each leaves in its folder."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A picture of the gallery.

    Attributes
    ----------
    name: of the picture's file
    caption: what it shows
    command: that makes it, without `chromagrip` and `--out`
    file: in the command's folder; of a video, the frame at `at_s`
    at_s: instant of the frame [s of playing]
    """

    name: str
    caption: str
    command: str
    file: str = "previews/preview-000.png"
    at_s: float = 0.0


GALLERY = {
    "Sensors": [
        Entry(
            name="thesis",
            caption="The dome of the thesis under a grip and a load to the right: the outer, "
            "magenta layer moves farther than the yellow one.",
            command="render --grip 3 --load 0.5",
        ),
        Entry(
            name="dome-2020",
            caption="The dome of 2020 as it was built: crooked, overlapping dots, visible seams.",
            command="render --scene chromatouch-2020 --press-mm 2",
        ),
        Entry(
            name="flat-2019",
            caption="The flat pad of 2019, pressed and sheared.",
            command="render --sensor flat-2019 --press-mm 0.5 --shear-mm 0.5",
        ),
    ],
    "Objects": [
        Entry(
            name="twist",
            caption="A ball that is pressed on the dome of 2022 and twisted: the motion swirls, "
            "and the ring of friction arrows is the torque.",
            command="render --sensor dome-2022 --object ball --press-mm 1.2 --twist-deg 25",
        ),
        Entry(
            name="edge",
            caption="The edge of a tilted box.",
            command="render --sensor dome-2022 --object box --tilt-deg 20 0 --press-mm 1.2",
        ),
        Entry(
            name="ring",
            caption="A ring that stands on its edge.",
            command="render --sensor dome-2022 --object torus --press-mm 0.8",
        ),
        Entry(
            name="shear",
            caption="A cylinder that is pressed and dragged along its axis.",
            command="render --sensor dome-2022 --object cylinder --press-mm 1.2 --shear-mm 0.6 0",
        ),
    ],
    "Grasps": [
        Entry(
            name="figure",
            caption="A grasp through the camera: forces, Γ with its interval and grip over time.",
            command="grasp",
            file="figure.png",
        ),
        Entry(
            name="tactile",
            caption="A frame of the same grasp's video: the picture, and the contact magnified.",
            command="grasp",
            file="tactile.mp4",
            at_s=6.0,
        ),
        Entry(
            name="dome",
            caption="The dome of 2022 holds an object that grows heavy.",
            command="grasp --scene chromatouch-2022",
            file="tactile.mp4",
            at_s=4.0,
        ),
        Entry(
            name="pinch",
            caption="Two fingers lift a box of 200 g.",
            command="grasp --scene pinch-lift --set duration_s=1.5",
            file="tactile.mp4",
            at_s=5.0,
        ),
    ],
    "Datasets": [
        Entry(
            name="sheet",
            caption="Contact sheet of a dataset: motion, forces and Γ of each sequence.",
            command="dataset make force --n 12",
            file="contact-sheet.png",
        ),
    ],
}
