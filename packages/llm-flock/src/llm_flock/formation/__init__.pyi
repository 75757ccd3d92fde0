from ._files import load_program as load_program
from ._placement import program_points as program_points
from ._program import Element as Element
from ._program import Group as Group
from ._program import Program as Program
from ._program import parse_program as parse_program
from ._program import program_of as program_of
from ._program import program_schema as program_schema
