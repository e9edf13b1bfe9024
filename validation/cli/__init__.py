"""Everything that the command lines of the programs share; only programs import it."""

from validation.cli.config import config_of as config_of
from validation.cli.config import read_result as read_result
from validation.cli.options import AnyPath as AnyPath
from validation.cli.options import AnyProfile as AnyProfile
from validation.cli.options import AnyRobot as AnyRobot
from validation.cli.options import Options as Options
from validation.cli.options import Since as Since
from validation.cli.options import read_value as read_value
from validation.cli.options import text_of as text_of
from validation.cli.process import ENDING as ENDING
from validation.cli.process import EXIT_FAULT as EXIT_FAULT
from validation.cli.process import EXIT_INTERRUPTED as EXIT_INTERRUPTED
from validation.cli.process import EXIT_USER_ERROR as EXIT_USER_ERROR
from validation.cli.process import parse_command as parse_command
from validation.cli.process import read_as as read_as
from validation.cli.process import run_command as run_command
from validation.cli.program import Common as Common
from validation.cli.program import Filmed as Filmed
from validation.cli.program import Program as Program
from validation.cli.program import make_program as make_program
from validation.cli.program import report_console as report_console
from validation.cli.program import report_result as report_result
from validation.cli.program import require_apart as require_apart
from validation.cli.program import require_writable as require_writable
from validation.cli.program import warn_user as warn_user
