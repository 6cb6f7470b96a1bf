"""Array types by dtype; shapes and units are given in the docstrings that use them."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U8: TypeAlias = NDArray[np.uint8]
U16: TypeAlias = NDArray[np.uint16]
U32: TypeAlias = NDArray[np.uint32]
U64: TypeAlias = NDArray[np.uint64]
Mask: TypeAlias = NDArray[np.bool_]

# contiguous arrays of so many dimensions, which is what compiled loops take
F32_1: TypeAlias = Annotated[F32, 1]
F32_2: TypeAlias = Annotated[F32, 2]
F32_3: TypeAlias = Annotated[F32, 3]
F64_1: TypeAlias = Annotated[F64, 1]
F64_2: TypeAlias = Annotated[F64, 2]
F64_3: TypeAlias = Annotated[F64, 3]
F64_4: TypeAlias = Annotated[F64, 4]
I32_1: TypeAlias = Annotated[I32, 1]
I32_2: TypeAlias = Annotated[I32, 2]
I32_3: TypeAlias = Annotated[I32, 3]
I64_1: TypeAlias = Annotated[I64, 1]
I64_2: TypeAlias = Annotated[I64, 2]
U8_1: TypeAlias = Annotated[U8, 1]
U8_2: TypeAlias = Annotated[U8, 2]
U64_2: TypeAlias = Annotated[U64, 2]
Mask_1: TypeAlias = Annotated[Mask, 1]
Mask_2: TypeAlias = Annotated[Mask, 2]
