namespace pave {}
