from .kind import file_and_function as file_and_function
from .kind import plugin_name as plugin_name
from .kind import program as program
from .new_planner import CARD as CARD
from .new_planner import TEMPLATE as TEMPLATE
from .plugin_files import read_files as read_files
