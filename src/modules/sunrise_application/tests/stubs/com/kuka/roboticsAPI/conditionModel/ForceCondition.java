package com.kuka.roboticsAPI.conditionModel;

import com.kuka.roboticsAPI.geometricModel.ObjectFrame;
import kstsim.SimRobot;

public final class ForceCondition implements ICondition {
    private final double limit;

    private ForceCondition(double limit) { this.limit = limit; }

    public static ForceCondition createSpatialForceCondition(ObjectFrame frame, double newton) {
        return new ForceCondition(newton);
    }

    @Override
    public boolean fired() {
        double[] f = SimRobot.force();
        return Math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) > limit;
    }
}
