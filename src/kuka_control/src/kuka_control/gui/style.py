"""Colours and sizes of the control panel, as a Qt style sheet."""

from __future__ import annotations

GREEN = "#2e9e44"
RED = "#c62828"

STYLE = f"""
ControlPanel {{ background-color: #f4f6f8; }}
ControlPanel QLabel {{ color: #1f2933; font-size: 11pt; }}
ControlPanel QGroupBox {{
  color: #52606d; font-size: 10pt; font-weight: bold;
  background-color: #ffffff; border: 1px solid #cbd2d9; border-radius: 8px; margin-top: 22px; padding: 6px;
}}
ControlPanel QGroupBox::title {{ subcontrol-origin: margin; left: 4px; top: 2px; }}
ControlPanel QPushButton {{
  color: #1f2933; background-color: #e4e7eb; font-size: 11pt; font-weight: normal;
  border: 2px solid #cbd2d9; border-radius: 6px; padding: 4px 10px;
}}
ControlPanel QPushButton:hover {{ background-color: #d8dde3; }}
ControlPanel QPushButton:pressed {{ background-color: #cbd2d9; }}
ControlPanel QPushButton:focus {{ border-color: #2563eb; }}
ControlPanel QPushButton:disabled {{ color: #9aa5b1; background-color: #f1f3f5; border-color: #e4e7eb; }}
ControlPanel QPushButton[checkable="true"] {{ font-size: 13pt; }}
ControlPanel QPushButton:checked {{
  color: white; background-color: {GREEN}; border-color: #23803a; font-weight: bold;
}}
ControlPanel QPushButton:checked:focus {{ border-color: #14532d; }}
ControlPanel QPushButton#emergency {{
  color: white; background-color: {RED}; border: 3px solid #8e1b1b; font-size: 15pt; font-weight: bold;
}}
ControlPanel QPushButton#emergency:focus {{ border-color: #1f2933; }}
ControlPanel QPushButton#emergency:hover {{ background-color: #d63232; }}
ControlPanel QPushButton#emergency:pressed {{ background-color: #8e1b1b; }}
ControlPanel QSlider::groove:horizontal {{ height: 6px; border-radius: 3px; background-color: #cbd2d9; }}
ControlPanel QSlider::sub-page:horizontal {{ border-radius: 3px; background-color: #2563eb; }}
ControlPanel QSlider::handle:horizontal {{
  width: 22px; height: 22px; margin: -10px 0; border: 2px solid #2563eb; border-radius: 12px; background-color: #ffffff;
}}
ControlPanel QSlider::handle:horizontal:focus {{ background-color: #bfd4fb; }}
ControlPanel QSlider::sub-page:horizontal:disabled {{ background-color: #b4bec8; }}
ControlPanel QSlider::handle:horizontal:disabled {{ border-color: #b4bec8; background-color: #f1f3f5; }}
ControlPanel QLabel:disabled {{ color: #9aa5b1; }}
ControlPanel QLabel#end {{ color: #7b8794; font-size: 9pt; }}
ControlPanel QLabel[tone] {{
  padding: 6px 10px; background-color: #ffffff; border: 1px solid #cbd2d9; border-radius: 6px;
}}
ControlPanel QLabel[tone="silent"] {{ background-color: transparent; border-color: transparent; }}
ControlPanel QLabel[tone="warning"] {{ background-color: #fff3d6; border-color: #e0b64a; }}
ControlPanel QLabel[tone="fault"] {{ background-color: #fde3e3; border-color: #d98282; }}
"""
