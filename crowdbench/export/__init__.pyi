from .replay_page import export_page as export_page
from .rosbag import typestore as typestore
