class AbstractType: ...

class BasicType(AbstractType):
    typename: str

class NamespacedType(AbstractType):
    namespaces: list[str]
    name: str

class AbstractGenericString(AbstractType): ...
class AbstractString(AbstractGenericString): ...

class AbstractNestedType(AbstractType):
    value_type: AbstractType

class Array(AbstractNestedType):
    size: int

class AbstractSequence(AbstractNestedType): ...
class UnboundedSequence(AbstractSequence): ...
