"""Vectors and 3x3 matrices as tuples: (x, y, z), and three rows. For floats, NumPy arrays and compiled lanes alike."""

from mgsgraph.compiled import equation


@equation
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@equation
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@equation
def add(a, b):
    """Sum of vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@equation
def subtract(a, b):
    """Difference of vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@equation
def scale(factor, a):
    """A vector times a number."""
    return factor * a[0], factor * a[1], factor * a[2]


@equation
def transform(matrix, a):
    """Matrix times vector."""
    return dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)


@equation
def transpose(matrix):
    """Rows become columns; of a rotation, the way back."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return (a, d, g), (b, e, h), (c, f, i)


@equation
def product(left, right):
    """Product of two matrices."""
    columns = transpose(right)
    return transform(columns, left[0]), transform(columns, left[1]), transform(columns, left[2])
