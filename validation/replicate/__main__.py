"""The command line `python -m validation.replicate`."""

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

from validation.replicate.run import replicate

if __name__ == "__main__":
    replicate.main()
