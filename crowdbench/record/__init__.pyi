from .write import Recorder as Recorder
