"""Structured text run without a PLC: parsed by tree-sitter's IEC 61131-3 grammar, turned into C statement by statement.

The grammar is independent of the package; the translation is these tests'. Every node of the tree becomes one C
expression in parentheses, so that the C computes what is written, in the order in which it is written.
"""

import ctypes
import subprocess

import numpy as np
import pytest

_TYPES = {"REAL": "float", "LREAL": "double", "INT": "int16_t", "DINT": "int32_t", "BOOL": "uint8_t"}
_OPERATORS = {"=": "==", "<>": "!=", "AND": "&&", "OR": "||", "MOD": "%", "NOT": "!"}
_HEAD = """#include <stdint.h>
#include <string.h>
#define SEL(g, a, b) ((g) ? (b) : (a))
#define MAX(a, b) (((a) > (b)) ? (a) : (b))
#define TRUNC(x) ((int32_t)(x))
#define DINT_TO_REAL(x) ((float)(x))
#define DINT_TO_LREAL(x) ((double)(x))
"""


def parsed(text):
    """The root of the tree; skips without the parser, fails at what is no structured text."""
    grammar = pytest.importorskip("tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed")
    tree_sitter = pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
    root = tree_sitter.Parser(tree_sitter.Language(grammar.language())).parse(text.encode()).root_node
    wrong = [node for node in _walk(root) if node.type == "ERROR" or node.is_missing]
    assert not wrong, [(node.start_point, node.text[:60]) for node in wrong]
    return root


def _walk(node):
    yield node
    for child in node.children:
        yield from _walk(child)


def _text(node):
    return node.text.decode()


def _field(node, name):
    return node.child_by_field_name(name)


def in_c(text):
    """C of all function blocks: a struct, NAME_init and NAME_run for each."""
    blocks = {}
    suffix = "F" if " OF REAL" in text else ""
    parts = [_HEAD]
    for node in parsed(text).children:
        if node.type == "function_block_declaration":
            block = _Block(node, blocks, suffix)
            blocks[block.name] = block
            parts.append(block.text())
    return "\n".join(parts)


class _Block:
    def __init__(self, node, others, suffix):
        self.node, self.others, self.suffix = node, others, suffix
        self.name = _text(_field(node, "name"))
        self.fields = {}  # name: (type, size or 0, by reference, initial values)
        for section in node.children:
            if section.type.startswith("var_"):
                for declared in section.children:
                    if declared.type == "variable_declaration":
                        self._declare(declared, section.type == "var_in_out")

    def _declare(self, node, by_reference):
        type_, size = _field(node, "type"), 0
        if type_.type == "array_type":
            size = int(_text(_field(_field(type_, "range"), "upper"))) + 1
            type_ = _field(type_, "element_type")
        values = []
        for value in (v for v in node.children_by_field_name("initial_value") if v.is_named):
            count, value = (
                (int(_text(_field(value, "count"))), value.named_children[-1])
                if value.type == "array_repetition"
                else (1, value)
            )
            values += [self._expression(value)] * count
        assert not values or len(values) == max(size, 1)
        for name in (n for n in node.children_by_field_name("names") if n.is_named):
            self.fields[_text(name)] = (_TYPES.get(_text(type_), _text(type_)), size, by_reference, values)

    def text(self):
        members, start = [], []
        for name, (type_, size, by_reference, values) in self.fields.items():
            members.append(f"    {type_} {f'*{name}' if by_reference else f'{name}[{size}]' if size else name};")
            if type_ in self.others:
                start.append(f"    {type_}_init(&self->{name});")
            elif values:
                start.append(f"    {{ static const {type_} start[] = {{ {', '.join(values)} }};")
                start.append(f"      memcpy(&self->{name}, start, sizeof start); }}")
        body = [self._statement(child) for child in self.node.children_by_field_name("body")]
        lines = ["typedef struct {", *members, f"}} {self.name};", f"void {self.name}_init({self.name} *self)", "{"]
        lines += ["    memset(self, 0, sizeof *self);", *start, "}", f"void {self.name}_run({self.name} *self)", "{"]
        return "\n".join([*lines, *body, "}", ""])

    def _statement(self, node):
        return getattr(self, f"_{node.type}")(node)

    def _all(self, node, field="body"):
        return " ".join(self._statement(child) for child in node.children_by_field_name(field))

    def _empty_statement(self, _node):
        return ""

    def _assignment_statement(self, node):
        return f"{self._expression(_field(node, 'left'))} = {self._expression(_field(node, 'right'))};"

    def _for_statement(self, node):
        k, step = self._expression(_field(node, "control")), _field(node, "step")
        first, last = (self._expression(_field(node, name)) for name in ("start", "end"))
        by = self._expression(step) if step is not None else "1"
        return f"for ({k} = {first}; {k} <= {last}; {k} += {by}) {{ {self._all(node)} }}"

    def _if_statement(self, node):
        text = f"if ({self._expression(_field(node, 'condition'))}) {{ {self._all(node, 'consequence')} }}"
        for child in node.children:
            if child.type == "elsif_clause":
                text += f" else if ({self._expression(_field(child, 'condition'))}) {{ {self._all(child)} }}"
            if child.type == "else_clause":
                text += f" else {{ {self._all(child)} }}"
        return text

    def _case_statement(self, node):
        text = f"switch ({self._expression(_field(node, 'subject'))}) {{ "
        for child in node.children:
            if child.type == "case_clause":
                (value,) = [c for c in child.children if c.type == "case_value"]
                text += f"case {_text(value)}: {self._all(child)} break; "
            if child.type == "else_clause":
                text += f"default: {self._all(child)} break; "
        return text + "}"

    def _invocation_statement(self, node):
        (call,) = node.named_children
        name = _text(_field(call, "function"))
        block = self.others[self.fields[name][0]]
        text = ""
        for argument in _field(call, "arguments").named_children:
            key, value = _text(_field(argument, "name")), self._expression(_field(argument, "value"))
            _type, size, by_reference, _values = block.fields[key]
            text += (
                f"memcpy(self->{name}.{key}, {value}, sizeof self->{name}.{key}); "
                if size and not by_reference
                else f"self->{name}.{key} = {value}; "
            )
        return f"{text}{block.name}_run(&self->{name});"

    def _expression(self, node):
        if node.type == "identifier":
            return f"(self->{_text(node)})" if _text(node) in self.fields else _text(node)
        if node.type == "real_literal":
            return f"({_text(node)}{self.suffix})"
        if node.type == "integer_literal":
            return f"({_text(node)})"
        if node.type == "boolean_literal":
            return "1" if _text(node) == "TRUE" else "0"
        if node.type == "parenthesized_expression":
            return self._expression(node.named_children[0])
        if node.type == "index_expression":
            return f"{self._expression(_field(node, 'object'))}[{self._expression(_field(node, 'index'))}]"
        if node.type == "member_access_expression":
            return f"({self._expression(_field(node, 'object'))}.{_text(_field(node, 'member'))})"
        if node.type == "call_expression":
            given = ", ".join(self._expression(c) for c in _field(node, "arguments").named_children)
            return f"{_text(_field(node, 'function'))}({given})"
        operator = _text(_field(node, "operator"))
        operator = _OPERATORS.get(operator, operator)
        if node.type == "unary_expression":
            return f"({operator}{self._expression(_field(node, 'operand'))})"
        assert node.type == "binary_expression", node.type
        return f"({self._expression(_field(node, 'left'))} {operator} {self._expression(_field(node, 'right'))})"


_ROWS = """
void rows(const {real} *q, const uint8_t *enable, int32_t count, {real} *out, int16_t *status)
{{
    static {block} block;
    int32_t row;
    {block}_init(&block);
    for (row = 0; row < count; row++)
    {{
        memcpy(block.q, q + {n} * row, sizeof block.q);
        {enable}
        {block}_run(&block);
        memcpy(out + {m} * row, block.{out}, sizeof block.{out});
        status[row] = block.status;
    }}
}}
uint8_t self_test(void)
{{
    static {name}_self_test block;
    {name}_self_test_init(&block);
    {name}_self_test_run(&block);
    return block.passed;
}}
"""


class Compiled:
    """The blocks of a structured text as a shared library: `rows` runs one of them, with one state for all rows."""

    def __init__(self, text, folder, compiler, name, block, out, joints=6, outputs=6):
        self.real = "float" if " OF REAL" in text else "double"
        self.dtype = np.float32 if self.real == "float" else np.float64
        enable = "block.enable = enable[row];" if block.endswith("step") else "(void)enable;"
        more = _ROWS.format(
            real=self.real, block=f"{name}_{block}", n=joints, m=outputs, out=out, enable=enable, name=name
        )
        source, library = folder / f"{block}_{self.real}.c", folder / f"{block}_{self.real}.so"
        source.write_text(in_c(text) + more)
        flags = ["-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared"]
        subprocess.run([compiler, *flags, str(source), "-o", str(library)], check=True)
        self.library, self.outputs = ctypes.CDLL(str(library)), outputs

    def rows(self, q, enable=None):
        """Outputs and statuses of rows of joints."""
        q = np.ascontiguousarray(q, self.dtype)
        enable = np.ascontiguousarray(np.ones(len(q)) if enable is None else enable, np.uint8)
        out, status = np.empty((len(q), self.outputs), self.dtype), np.empty(len(q), np.int16)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (q, enable, out, status)]
        self.library.rows(*pointers[:2], ctypes.c_int32(len(q)), *pointers[2:])
        return out, status

    def self_test(self):
        """Whether the block of known answers passes."""
        return bool(self.library.self_test())
