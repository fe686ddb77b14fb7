"""The type stubs say what there is."""

import ast
import inspect
import sys
from pathlib import Path

import numpy as np

import sparsesplat as ss
from sparsesplat import _native

STUBS = ast.parse((Path(ss.__file__).parent / "_native.pyi").read_text(encoding="utf-8"))


def parameters(node):
    """Names, kinds and defaults of a function of the stubs, without self."""
    arguments = node.args
    positional = arguments.posonlyargs + arguments.args
    defaults = [None] * (len(positional) - len(arguments.defaults)) + list(arguments.defaults)
    found = [(a.arg, "positional", d) for a, d in zip(positional, defaults)]
    found += [(a.arg, "keyword", d) for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults)]
    return [one for one in found if one[0] != "self"]


def value(node):
    return None if node is None else eval(compile(ast.Expression(node), "stub", "eval"))


def check(function, node):
    expected = [(name, kind, node is not None, value(node)) for name, kind, node in parameters(node)]
    found = []
    for parameter in inspect.signature(function).parameters.values():
        kind = "keyword" if parameter.kind is parameter.KEYWORD_ONLY else "positional"
        has_default = parameter.default is not parameter.empty
        if parameter.name != "self":
            found.append((parameter.name, kind, has_default, parameter.default if has_default else None))
    assert found == expected, node.name


def test_functions_and_classes_are_those_of_the_stubs():
    names = set()
    for node in STUBS.body:
        if isinstance(node, ast.FunctionDef):
            check(getattr(_native, node.name), node)
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            home = getattr(_native, node.name)
            members = set()
            for member in node.body:
                members.add(member.name)
                decorators = [ast.unparse(decorator) for decorator in member.decorator_list]
                if "property" in decorators:
                    assert inspect.isgetsetdescriptor(getattr(home, member.name)), member.name
                elif member.name != "__init__" or sys.version_info >= (3, 10):
                    # Python 3.9 knows no signatures of compiled classes.
                    check(home if member.name == "__init__" else getattr(home, member.name), member)
            there = {name for name in vars(home) if not name.startswith("_")}
            assert there == {name for name in members if not name.startswith("__")}, node.name
        else:
            continue
        names.add(node.name)
    there = {name for name in vars(_native) if not name.startswith("_")}
    assert there == names == set(ss.__all__) - {"Gaussians"}


def test_defaults_of_the_settings_are_those_that_are_used():
    means, one = np.float32([[0, 0, 2]]), np.ones(1, np.float32)
    arrays = [means, np.float32([[1, 0, 0, 0]]), np.full((1, 3), 0.3, np.float32), one, np.float32([[1, 0.5, 0]])]
    views = [np.eye(4)[None], np.float64([[[30, 0, 10], [0, 30, 8], [0, 0, 1]]]), 20, 16]
    node = next(node for node in STUBS.body if getattr(node, "name", "") == "rasterize")
    defaults = {name: value(node) for name, kind, node in parameters(node) if kind == "keyword"}
    colors, alphas, _ = ss.rasterize(*arrays, *views)
    again, alphas_again, _ = ss.rasterize(*arrays, *views, **defaults)
    assert (colors == again).all() and (alphas == alphas_again).all() and colors.max() > 0.9
