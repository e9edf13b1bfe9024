"""MuJoCo's arrays for compiled callbacks, which get the addresses of its model and data as numbers."""

from __future__ import annotations

import ctypes
from typing import Any

from llvmlite import ir
from numba import types

from ssmr._jit import built_in

_WORD = 8
"""Bytes of a pointer and of a number."""


@built_in
def number(typing: Any, pointer: Any, index: Any) -> Any:
    """Return a number of the array that the pointer at an address points to."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(builder, *arguments))

    return types.float64(types.intp, types.intp), build


@built_in
def set_number(typing: Any, pointer: Any, index: Any, value: Any) -> Any:
    """Set a number of the array that the pointer at an address points to."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _place(builder, *arguments[:2]))
        return context.get_dummy_value()

    return types.none(types.intp, types.intp, types.float64), build


def _place(builder: Any, pointer: Any, index: Any) -> Any:
    array = builder.load(builder.inttoptr(pointer, ir.DoubleType().as_pointer().as_pointer()))
    return builder.gep(array, [index])


@built_in
def integer(typing: Any, address: Any) -> Any:
    """Return the 32-bit integer at an address."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = builder.load(builder.inttoptr(arguments[0], ir.IntType(32).as_pointer()))
        return builder.sext(value, ir.IntType(64))

    return types.intp(types.intp), build


@built_in
def address(typing: Any, pointer: Any) -> Any:
    """Return the address that the pointer at an address holds."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], ir.IntType(64).as_pointer()))

    return types.intp(types.intp), build


def offset(struct: Any, array: Any) -> int:
    """Return where MuJoCo's struct holds the pointer to one of its arrays [bytes]: Python's binding does not say."""
    words, k = ctypes.cast(struct._address, ctypes.POINTER(ctypes.c_size_t)), 0
    while words[k] != array.ctypes.data:
        k += 1
    return _WORD * k
