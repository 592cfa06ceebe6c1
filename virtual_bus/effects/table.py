"""Effects of a machine as the arrays that its compiled plant reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from virtual_bus.effects.effect import COUPLING, FRICTION, LIMIT, MAX_PARAMETERS, SHARED_FRICTION, SUPPLY, TRANSMISSION
from virtual_bus.effects.places import joint_at, next_axis, spring_at
from virtual_bus.effects.registry import effect_number, effects, module_of
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting, PlantSettings

MAX_FRICTIONS = 32  # effects of one kind of one machine: a compiled plant's tables have a fixed size
MAX_EFFORTS = 32
MAX_PAIRS = 8
MAX_SHARED = 8
MAX_REACTIONS = 8
LIMITS = 2  # of a drive's current: what its supply gives, then what its amplifier passes
HELD_SAMPLES = 16  # targets that a delayed drive remembers
WHOLE = 1e-9
"""Of a sample: a delay this close to whole samples is meant to be whole."""
ROW = 1 + MAX_PARAMETERS  # effect number, then its parameters


def values_of(setting: EffectSetting) -> list[float]:
    """Return an effect's parameters in its own order; what is left out has its default."""
    given, parameters = setting.parameters, effects()[setting.name].parameters
    return [given[each.name] if each.default is None else given.get(each.name, each.default) for each in parameters]


def effect_row(setting: EffectSetting) -> np.ndarray:
    """Return effect number, then the effect's parameters in its own order, then zeros: (ROW,)."""
    row = np.zeros(ROW)
    values = values_of(setting)
    row[0] = effect_number(setting.name)
    row[1 : 1 + len(values)] = values
    return row


def with_hook(settings: Sequence[EffectSetting], hook: str, most: int | None = None) -> list[EffectSetting]:
    """Return the effects whose file has this hook.

    Raises
    ------
    EffectError
        There are more of them than `most`, which a table has room for.
    """
    chosen = [setting for setting in settings if hasattr(module_of(setting.name), hook)]
    if most is not None and len(chosen) > most:
        raise EffectError(f"{len(chosen)} effects of the kind of {chosen[0].name}: a machine takes at most {most}")
    return chosen


def changed_values(by_quantity: dict[tuple[str, str], float], chosen: Sequence[EffectSetting], settings: PlantSettings) -> None:
    """Change the machine's own numbers as the effects say.

    Keys of `by_quantity` are (owner, quantity).
    """
    for setting in with_hook(chosen, "CHANGES"):
        effect, values = effects()[setting.name], values_of(setting)
        for owner_kind, quantity, change in module_of(setting.name).CHANGES:
            owner: str | None = setting.at
            if owner_kind == "joint":
                owner = spring_at(setting.at, settings) if effect.kind.needs == "spring" else joint_at(setting.at, settings)
            assert owner is not None
            by_quantity[owner, quantity] = change(by_quantity[owner, quantity], *values)


def fill_friction(record: np.record, chosen: Sequence[EffectSetting], settings: PlantSettings) -> None:
    """Put friction rows into a plant's record, sorted by joint.

    Those of joint j are friction_first[j] to friction_first[j + 1].
    """
    number = settings.tree.joint_index
    frictions = with_hook([setting for setting in chosen if effects()[setting.name].kind is FRICTION], "level", MAX_FRICTIONS)
    frictions.sort(key=lambda setting: number(joint_at(setting.at, settings)))
    counts = np.zeros(len(settings.tree.joints), dtype=np.int64)
    for k, setting in enumerate(frictions):
        record["friction_rows"][k] = effect_row(setting)
        counts[number(joint_at(setting.at, settings))] += 1
    record["friction_first"] = np.concatenate(([0], np.cumsum(counts)))


def fill_shared(record: np.record, chosen: Sequence[EffectSetting], settings: PlantSettings) -> None:
    """Put friction of motors that turn with two axes into a plant's record: the next axis's joint, then the own one and its share."""
    shared = with_hook([setting for setting in chosen if effects()[setting.name].kind is SHARED_FRICTION], "level", MAX_SHARED)
    record["shared_count"] = len(shared)
    for k, setting in enumerate(shared):
        row = effect_row(setting)
        joints = [settings.tree.joint_index(joint_at(at, settings)) for at in (next_axis(setting.at, settings), setting.at)]
        record["shared_rows"][k] = row
        record["shared_joints"][k] = joints
        record["share"][k] = module_of(setting.name).share(*values_of(setting))
        record["reacts"][joints] = 1


def fill_terms(record: np.record, chosen: Sequence[EffectSetting], ratio_of_axis: dict[str, float], settings: PlantSettings) -> None:
    """Put efforts on one joint, and terms between two, into a plant's record."""
    number = settings.tree.joint_index
    efforts = with_hook(chosen, "effort", MAX_EFFORTS)
    record["effort_count"] = len(efforts)
    for k, setting in enumerate(efforts):
        elastic = effects()[setting.name].kind.needs == "spring"
        joint = spring_at(setting.at, settings) if elastic else joint_at(setting.at, settings)
        assert joint is not None
        record["effort_rows"][k] = effect_row(setting)
        record["effort_joint"][k] = number(joint)
        record["effort_ratio"][k] = ratio_of_axis.get(setting.at, 1.0)
    pairs = with_hook(chosen, "terms", MAX_PAIRS)
    record["pair_count"] = len(pairs)
    for k, setting in enumerate(pairs):
        kind = effects()[setting.name].kind
        assert kind in (TRANSMISSION, COUPLING)
        other = spring_at(setting.at, settings) if kind is TRANSMISSION else joint_at(next_axis(setting.at, settings), settings)
        assert other is not None
        record["pair_rows"][k] = effect_row(setting)
        record["pair_joints"][k] = number(joint_at(setting.at, settings)), number(other)
        record["pair_ratio"][k] = ratio_of_axis[setting.at]
        record["pair_is_spring"][k] = kind is TRANSMISSION


def fill_reactions(record: np.record, chosen: Sequence[EffectSetting], settings: PlantSettings) -> None:
    """Put effects with a memory of their own into a plant's record."""
    reactions = with_hook(chosen, "react", MAX_REACTIONS)
    record["reaction_count"] = len(reactions)
    for k, setting in enumerate(reactions):
        joint = settings.tree.joint_index(joint_at(setting.at, settings))
        record["reaction_rows"][k] = effect_row(setting)
        record["reaction_joint"][k] = joint
        record["reacts"][joint] = 1


def fill_drives(record: np.record, chosen: Sequence[EffectSetting], ratio_of_axis: dict[str, float], settings: PlantSettings) -> None:
    """Put delay, low pass, limit and ripple of every drive into a plant's record.

    Raises
    ------
    EffectError
        A delay longer than a drive remembers.
    """
    axes = [drive.axis for drive in settings.drives]
    record["drive_ratio"][: len(axes)] = [ratio_of_axis[axis] for axis in axes]
    record["limit_rows"][..., 0] = -1.0
    record["ripple_rows"][:, 0] = -1.0
    for setting in chosen:
        module, values = module_of(setting.name), values_of(setting)
        if hasattr(module, "limited"):
            order = (SUPPLY, LIMIT).index(effects()[setting.name].kind)
            record["limit_rows"][axes.index(setting.at), order] = effect_row(setting)
        elif hasattr(module, "factor"):
            record["ripple_rows"][axes.index(setting.at)] = effect_row(setting)
        elif hasattr(module, "delay_s"):
            samples = module.delay_s(*values) / settings.sample_period_s
            if samples >= HELD_SAMPLES:
                most = HELD_SAMPLES * settings.sample_period_s
                raise EffectError(f"{setting.name} at {setting.at!r}: Td = {values[0]:g} s: a drive here remembers less than {most:g} s")
            whole = round(samples)  # a quotient of decimal fractions misses it by little, which would decide what flows at a SYNC
            record["delay_samples"][axes.index(setting.at)] = whole if abs(samples - whole) < WHOLE else samples
        elif hasattr(module, "transition"):
            axis = axes.index(setting.at)
            record["is_lagging"][axis] = values[0] > 0.0
            if values[0] > 0.0:
                record["lag_transition"][axis], record["lag_mean"][axis] = module.transition(record["step_s"], *values)
        else:
            continue
        record["has_drive_effects"] = 1


def targets_at_rest(model: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """Return what drives (axes,) must be asked for, so that these currents flow at rest through what supplies them."""
    targets = currents.copy()
    for axis, row in enumerate(model["limit_rows"][0, : len(currents), 0]):
        if row[0] >= 0.0:
            effect = list(effects().values())[int(row[0])]
            targets[axis] = module_of(effect.name).target(float(currents[axis]), *row[1 : 1 + len(effect.parameters)].tolist())
    return targets
