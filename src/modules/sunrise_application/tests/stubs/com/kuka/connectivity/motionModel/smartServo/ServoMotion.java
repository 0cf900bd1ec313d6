package com.kuka.connectivity.motionModel.smartServo;

import com.kuka.roboticsAPI.geometricModel.Tool;
import kstsim.SimRobot;

public abstract class ServoMotion {
    public static boolean validateForImpedanceMode(Tool tool) {
        return !"false".equals(SimRobot.word("load", "true"));
    }
}
