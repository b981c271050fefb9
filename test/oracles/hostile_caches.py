# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Attacks on the store of machine code: folders and files as another user would plant them."""

import os


def give_to_another(path, patch):
    """
    Give a file to another user, or simulate that where this process may not.

    `patch` is a function(object, str, object) that replaces an attribute until the test ends.
    """
    if os.geteuid() == 0:
        os.chown(path, 4321, -1)
        return
    theirs, fstat = path.stat(), os.fstat

    def seen(descriptor):
        status = fstat(descriptor)
        other = status.st_uid + os.path.samestat(status, theirs)
        return os.stat_result((*status[:4], other, *status[5:]))

    patch(os, 'fstat', seen)


def link(path):
    """Put a symbolic link in the place of a file or folder."""
    path.symlink_to(path.rename(path.with_name(f'planted-{path.name}')))


def link_to_root(leaf):
    """Put machine code into the root, and a link to the root in the place of the leaf."""
    for file in leaf.iterdir():
        file.rename(leaf.parent / file.name)
    leaf.rmdir()
    leaf.symlink_to('.')


FOLDERS = {
    'root 0777': lambda leaf, patch: leaf.parent.chmod(0o777),
    'root 1777': lambda leaf, patch: leaf.parent.chmod(0o1777),
    'root 0770': lambda leaf, patch: leaf.parent.chmod(0o770),
    'leaf 0777': lambda leaf, patch: leaf.chmod(0o777),
    'leaf 0720': lambda leaf, patch: leaf.chmod(0o720),
    'root is a link': lambda leaf, patch: link(leaf.parent),
    'leaf is a link': lambda leaf, patch: link(leaf),
    'leaf is a link to the root': lambda leaf, patch: link_to_root(leaf),
    "root is another's": lambda leaf, patch: give_to_another(leaf.parent, patch),
    "leaf is another's": lambda leaf, patch: give_to_another(leaf, patch)}


def another_pipe(file, patch):
    """Put a pipe in the place of a file: to open it for reading would wait for a writer."""
    file.unlink()
    os.mkfifo(file)
    give_to_another(file, patch)


FILES = {
    '0666': lambda file, patch: file.chmod(0o666),
    '0620': lambda file, patch: file.chmod(0o620),
    'link': lambda file, patch: link(file),
    "another's": give_to_another,
    "another's pipe": another_pipe}
