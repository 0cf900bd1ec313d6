package com.kuka.roboticsAPI.motionModel;

import kstsim.SimRobot;

/** Stands still until it is cancelled: nobody guides the stub. */
public class HandGuidingMotion implements IMotion {
    @Override
    public IMotionContainer start(double[][] tool) { return SimRobot.hold(); }
}
