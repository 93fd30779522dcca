"""Draw the README's picture: what the demonstration's residual holds before and after the hidden effect is added.

python benchmarks/readme_picture.py
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import rx90b_flex as rf
from rx90b_flex.demo import make_demonstration
from rx90b_flex.view import plots

PICTURE = Path(__file__).resolve().parent.parent / ".readme" / "residual.png"


def main() -> None:
    """Close the loop on the demonstration with Stribeck friction hidden and save the residual against velocity."""
    with TemporaryDirectory() as folder:
        result = rf.close_loop(make_demonstration(3, "stribeck_friction").write(Path(folder)))
    joint = result.effects[0].effect.joints[0]
    PICTURE.parent.mkdir(exist_ok=True)
    plots.residual_against_velocity(result, joint).savefig(PICTURE, dpi=150)


if __name__ == "__main__":
    main()
