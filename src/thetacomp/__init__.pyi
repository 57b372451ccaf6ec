# What type checkers see of the lazy names. The code itself must not import them: the machine wing starts here, too.
from thetacomp.api import analyze as analyze
from thetacomp.api import export as export
from thetacomp.api import load_model as load_model
from thetacomp.api import read_folder as read_folder
from thetacomp.api import read_frames as read_frames
from thetacomp.api import verify as verify

__version__: str
