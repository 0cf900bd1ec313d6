package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.geometricModel.Frame;

public class CIRC extends CartesianMotion<CIRC> {
    CIRC(Frame via, Frame end) { super(via, end, null); }
}
