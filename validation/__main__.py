"""`python -m validation` is the command `ssmr`: without a program it lists them all."""

from validation.interrupts import end_quietly


def main() -> None:
    """Run the program that the command line names first.

    Ctrl-C has no traceback, even while libraries load.
    """
    end_quietly()
    from validation.cli.__main__ import main as run_program

    run_program()


if __name__ == "__main__":
    main()
