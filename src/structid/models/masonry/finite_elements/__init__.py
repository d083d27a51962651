"""The finite element model of a wall: layout, mesh, elements, assembly."""
