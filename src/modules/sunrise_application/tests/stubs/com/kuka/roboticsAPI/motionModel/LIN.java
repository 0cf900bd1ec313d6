package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.geometricModel.Frame;

public class LIN extends CartesianMotion<LIN> {
    LIN(Frame end) { super(null, end, null); }
}
