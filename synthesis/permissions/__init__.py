"""Permissive certificates: menus within which any behaviour keeps a success probability."""

from .permission import Menus, Permission
from .permission_check import check_permission
from .permission_file import is_permission_file, load_permission, save_permission
from .permitting import permit

__all__ = [
    "Menus",
    "Permission",
    "check_permission",
    "is_permission_file",
    "load_permission",
    "permit",
    "save_permission",
]
