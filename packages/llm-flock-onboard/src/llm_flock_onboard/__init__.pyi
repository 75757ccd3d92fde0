from ._distill.training import TrainingOptions as TrainingOptions
from ._distill.training import train as train
from ._local.model import LocalModel as LocalModel
