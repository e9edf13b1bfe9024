"""Everything around the mathematics of `ssmr`: the MuJoCo robot, recordings, profiles, programs and pictures."""

import sys

import lazy_loader as lazy

_program = " ".join(sys.orig_argv).partition(" -m ")[2] if sys.argv[:1] == ["-m"] else sys.argv[0]
if _program.split(" ")[0].split(".")[0] == "validation" or _program.endswith("/ssmr"):
    import signal  # while a program of ours is loaded, Ctrl-C ends it without a traceback

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
