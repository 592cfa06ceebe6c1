"""Let a drive fail in the middle of a motion: the bench stops the motors, and what was recorded until then is kept."""

from pathlib import Path

import hil

turntable = hil.open_machine("turntable")
Path("faults.toml").write_text('[[fault]]\nname = "drive_hangs"\nat = "turn_drive"\nwhen = "position_turn > 0.02"\n')

try:
    turntable.run(hil.JogOnly(jog=hil.Jog(line=1), period_s=8.0, periods=1), bus="lockstep:", faults="faults.toml", out="stopped.mf4")
except hil.LoopAbortedError as error:
    print(f"stopped: {error}")

recorded = hil.read_recording("stopped.mf4")
last = recorded["position_turn"][~recorded.channel("position_turn").missing][-1]
print(f"{recorded.rows} rows are kept; when it was last seen the table stood at {last:+.4f} rad")
