"""The checks, one file for each group, in the order in which they are made."""

from __future__ import annotations

from hil.conform.check import Check
from hil.conform.checks import (
    cob_ids,
    dictionary,
    emergency,
    error_control,
    identity,
    layer_settings,
    mapping,
    network,
    receive_pdo,
    sdo,
    sdo_block,
    sdo_segmented,
    storage,
    sync,
    transmit_pdo,
)

GROUPS = (
    identity, dictionary, sdo, sdo_segmented, sdo_block, network, error_control, cob_ids, mapping, sync, transmit_pdo, receive_pdo,
    emergency, layer_settings, storage,
)  # fmt: skip
ALL: tuple[Check, ...] = tuple(check for group in GROUPS for check in group.CHECKS.all)
