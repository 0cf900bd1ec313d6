package com.kuka.roboticsAPI.deviceModel;

import com.kuka.roboticsAPI.controllerModel.sunrise.ISafetyState;
import com.kuka.roboticsAPI.controllerModel.sunrise.SunriseSafetyState;
import com.kuka.roboticsAPI.geometricModel.Frame;
import com.kuka.roboticsAPI.geometricModel.ObjectFrame;
import com.kuka.roboticsAPI.motionModel.IMotion;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import com.kuka.roboticsAPI.sensorModel.ForceSensorData;
import com.kuka.roboticsAPI.sensorModel.TorqueSensorData;
import kstsim.SimRobot;

public class LBR extends Device {
    private final ObjectFrame flange = new ObjectFrame("Flange", null);

    public JointPosition getCurrentJointPosition() { return new JointPosition(SimRobot.joints()); }

    public int getJointCount() { return 7; }

    public ObjectFrame getFlange() { return flange; }

    public Frame getCurrentCartesianPosition(ObjectFrame f) {
        return Frame.of(SimRobot.KIN.fk(SimRobot.joints(), f.fromFlange()));
    }

    public TorqueSensorData getMeasuredTorque() { return new TorqueSensorData(SimRobot.tauMeasured()); }

    public TorqueSensorData getExternalTorque() { return new TorqueSensorData(SimRobot.tauExternal()); }

    public ForceSensorData getExternalForceTorque(ObjectFrame f) {
        return new ForceSensorData(SimRobot.force(), SimRobot.moment());
    }

    public OperationMode getOperationMode() { return OperationMode.valueOf(SimRobot.word("mode", "T1")); }

    public ISafetyState getSafetyState() {
        return new ISafetyState() {
            @Override
            public SunriseSafetyState.EnablingDeviceState getEnablingDeviceState() {
                return SunriseSafetyState.EnablingDeviceState.valueOf(SimRobot.word("enabling", "NORMAL"));
            }

            @Override
            public SunriseSafetyState.SafetyStopType getSafetyStopSignal() {
                return SunriseSafetyState.SafetyStopType.valueOf(SimRobot.word("stop", "NOSTOP"));
            }
        };
    }

    public IMotionContainer moveAsync(IMotion m) { return flange.moveAsync(m); }
}
