"""Everything that the command lines of the programs share; only the programs' `__main__` modules import it.

A program declares its options as a frozen dataclass, and hands the function that takes them to `run`.
"""

from validation.cli.options import NUMBERS as NUMBERS
from validation.cli.options import AnyProfile as AnyProfile
from validation.cli.options import AnyRobot as AnyRobot
from validation.cli.options import Bounds as Bounds
from validation.cli.options import Count as Count
from validation.cli.options import Flag as Flag
from validation.cli.options import Ground as Ground
from validation.cli.options import Limits as Limits
from validation.cli.options import Names as Names
from validation.cli.options import Number as Number
from validation.cli.options import Numbers as Numbers
from validation.cli.options import RobotName as RobotName
from validation.cli.options import Seed as Seed
from validation.cli.options import Topics as Topics
from validation.cli.options import UserError as UserError
from validation.cli.options import Values as Values
from validation.cli.options import Workers as Workers
from validation.cli.options import controller_and_reference as controller_and_reference
from validation.cli.options import one_of as one_of
from validation.cli.options import option as option
from validation.cli.options import out_option as out_option
from validation.cli.options import parsed as parsed
from validation.cli.options import profile_option as profile_option
from validation.cli.options import read_values as read_values
from validation.cli.options import require_rerun as require_rerun
from validation.cli.options import text_of as text_of
from validation.cli.program import Common as Common
from validation.cli.program import Filmed as Filmed
from validation.cli.program import Program as Program
from validation.cli.program import finish as finish
from validation.cli.program import program as program
from validation.cli.reporting import report_console as report_console
from validation.cli.reporting import report_result as report_result
from validation.cli.reporting import shown as shown
from validation.cli.reporting import warn as warn
from validation.cli.running import EXIT_FAULT as EXIT_FAULT
from validation.cli.running import EXIT_INTERRUPTED as EXIT_INTERRUPTED
from validation.cli.running import EXIT_USER_ERROR as EXIT_USER_ERROR
from validation.cli.running import leave_out as leave_out
from validation.cli.running import mistakes_are_users as mistakes_are_users
from validation.cli.running import options_type as options_type
from validation.cli.running import output_folder as output_folder
from validation.cli.running import require_writable as require_writable
from validation.cli.running import run as run
from validation.cli.running import search_kept_in as search_kept_in
from validation.cli.running import writes as writes
