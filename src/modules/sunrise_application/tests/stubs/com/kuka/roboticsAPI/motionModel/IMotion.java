package com.kuka.roboticsAPI.motionModel;

/** A motion that the stub robot can start for a tool frame given as a transform from the flange. */
public interface IMotion {
    IMotionContainer start(double[][] tool);
}
