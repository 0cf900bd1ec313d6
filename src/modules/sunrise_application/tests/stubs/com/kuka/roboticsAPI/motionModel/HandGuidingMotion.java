package com.kuka.roboticsAPI.motionModel;

import kstsim.SimRobot;

/** Stands still: nobody guides the stub. */
public class HandGuidingMotion implements IMotion {
    @Override
    public IMotionContainer start(double[][] tool) { return SimRobot.guide(); }
}
