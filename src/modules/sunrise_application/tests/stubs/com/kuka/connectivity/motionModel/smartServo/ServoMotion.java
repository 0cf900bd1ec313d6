package com.kuka.connectivity.motionModel.smartServo;

import com.kuka.roboticsAPI.geometricModel.Tool;

public abstract class ServoMotion {
    public static boolean validateForImpedanceMode(Tool tool) {
        return !"false".equals(System.getProperty("sim.impedance_ok", "true"));
    }
}
