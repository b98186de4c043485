class AbstractType: ...

class BasicType(AbstractType):
    typename: str

class NamespacedType(AbstractType):
    namespaces: list[str]
    name: str

class AbstractGenericString(AbstractType): ...

class AbstractNestedType(AbstractType):
    value_type: AbstractType

class Array(AbstractNestedType):
    size: int

class UnboundedSequence(AbstractNestedType): ...
