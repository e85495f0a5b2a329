from .plugin_files import read_files as read_files
