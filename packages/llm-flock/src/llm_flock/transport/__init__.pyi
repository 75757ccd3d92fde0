from ._radio import Radio as Radio
from ._radio import Seen as Seen
