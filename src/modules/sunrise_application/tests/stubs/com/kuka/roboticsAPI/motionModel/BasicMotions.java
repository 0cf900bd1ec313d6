package com.kuka.roboticsAPI.motionModel;

import com.kuka.roboticsAPI.geometricModel.Frame;

public final class BasicMotions {
    private BasicMotions() { }

    public static PTP ptp(double... joints) { return new PTP(joints.clone()); }

    public static LIN lin(Frame end) { return new LIN(end); }

    public static CIRC circ(Frame via, Frame end) { return new CIRC(via, end); }
}
