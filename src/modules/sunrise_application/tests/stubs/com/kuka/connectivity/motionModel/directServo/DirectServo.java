package com.kuka.connectivity.motionModel.directServo;

import com.kuka.roboticsAPI.deviceModel.JointPosition;
import com.kuka.roboticsAPI.geometricModel.Frame;
import com.kuka.roboticsAPI.geometricModel.ObjectFrame;
import com.kuka.roboticsAPI.motionModel.IMotion;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import kstsim.Kin;
import kstsim.SimRobot;

public class DirectServo implements IMotion {
    private double[][] tool = Kin.fromXyzAbc(new double[6]);

    public DirectServo(JointPosition start) { }

    public DirectServo setMinimumTrajectoryExecutionTime(double seconds) { return this; }

    @Override
    public IMotionContainer start(double[][] toolOfMotion) {
        tool = toolOfMotion;
        SimRobot.startServo(1);
        return SimRobot.servo();
    }

    public IDirectServoRuntime getRuntime() {
        return new IDirectServoRuntime() {
            @Override public JointPosition getCurrentJointDestination() { return new JointPosition(SimRobot.currentGoal()); }

            @Override public Frame getCurrentCartesianDestination(ObjectFrame f) {
                return Frame.of(SimRobot.KIN.fk(SimRobot.currentGoal(), f.fromFlange()));
            }

            @Override public void setDestination(JointPosition p) { SimRobot.servoGoal(p.array()); }

            @Override public void setDestination(Frame f) {
                SimRobot.servoGoal(SimRobot.KIN.ik(SimRobot.currentGoal(), Kin.fromXyzAbc(f.array()), tool, 20));
            }

            @Override public void updateWithRealtimeSystem() { }

            @Override public void stopMotion() { SimRobot.stopServo(); }
        };
    }
}
