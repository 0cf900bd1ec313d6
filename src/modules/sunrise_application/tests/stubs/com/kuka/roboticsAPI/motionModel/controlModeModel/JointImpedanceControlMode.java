package com.kuka.roboticsAPI.motionModel.controlModeModel;

public class JointImpedanceControlMode implements IMotionControlMode {
    private final double[] stiffness;
    private double damping = 0.7;

    public JointImpedanceControlMode(double... stiffness) { this.stiffness = stiffness.clone(); }

    public JointImpedanceControlMode setDampingForAllJoints(double v) {
        if (!(v >= 0 && v <= 1)) throw new IllegalArgumentException("damping " + v + " is not in 0..1");
        damping = v;
        return this;
    }

    @Override
    public String toString() { return "joints " + java.util.Arrays.toString(stiffness) + " damping " + damping; }
}
