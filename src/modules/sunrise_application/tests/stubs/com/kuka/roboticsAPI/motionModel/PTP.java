package com.kuka.roboticsAPI.motionModel;

import kstsim.SimRobot;

public class PTP extends RobotMotion<PTP> {
    private final double[] target;
    private double rel = 1;

    PTP(double[] target) { this.target = target; }

    public PTP setJointVelocityRel(double v) {
        rel = v;
        return this;
    }

    @Override
    public IMotionContainer start(double[][] tool) { return SimRobot.ptp(target, rel, conditions); }
}
