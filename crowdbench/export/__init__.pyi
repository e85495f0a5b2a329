from .replay_page import export_page as export_page
from .rosbag import ros_typestore as ros_typestore
