package com.kuka.connectivity.motionModel.smartServo;

import com.kuka.roboticsAPI.deviceModel.JointPosition;
import com.kuka.roboticsAPI.motionModel.IMotion;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import com.kuka.roboticsAPI.motionModel.controlModeModel.IMotionControlMode;
import kstsim.SimRobot;

public class SmartServo extends ServoMotion implements IMotion {
    private double rel = 1;

    public SmartServo(JointPosition start) { }

    public SmartServo setJointAccelerationRel(double v) { return this; }

    public SmartServo setJointVelocityRel(double v) {
        rel = v;
        return this;
    }

    public SmartServo setMinimumTrajectoryExecutionTime(double seconds) { return this; }

    public SmartServo setMode(IMotionControlMode mode) {
        SimRobot.note("soft " + mode);
        return this;
    }

    @Override
    public IMotionContainer start(double[][] tool) {
        SimRobot.startServo(rel);
        return SimRobot.servo();
    }

    public ISmartServoRuntime getRuntime() {
        return new ISmartServoRuntime() {
            @Override public JointPosition getAxisQMsrOnController() { return new JointPosition(SimRobot.joints()); }

            @Override public void setDestination(JointPosition p) { SimRobot.servoGoal(p.array()); }

            @Override public void updateWithRealtimeSystem() { }

            @Override public void stopMotion() { SimRobot.stopServo(); }
        };
    }
}
