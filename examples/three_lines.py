"""The thesis's experiment through the camera, in three lines of Python."""

import chromagrip


def main() -> None:
    result = chromagrip.run("camera-100hz")
    print(f"margin at the end {result.summary['final_margin_true']:.2f}")
    assert not result.summary["gross_slip"]


if __name__ == "__main__":
    main()
