"""Ctrl-C while a program still loads its libraries.

Each entry point asks for a quiet end before its other imports.
"""

import signal


def end_quietly() -> None:
    """Let Ctrl-C end this process without a traceback, until `validation.cli.run` handles it.

    Where Ctrl-C is ignored, it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
