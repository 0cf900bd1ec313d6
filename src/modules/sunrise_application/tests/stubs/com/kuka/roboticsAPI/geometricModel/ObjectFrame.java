package com.kuka.roboticsAPI.geometricModel;

import com.kuka.roboticsAPI.geometricModel.math.XyzAbcTransformation;
import com.kuka.roboticsAPI.motionModel.IMotion;
import com.kuka.roboticsAPI.motionModel.IMotionContainer;
import kstsim.Kin;

public class ObjectFrame {
    private final double[][] t;

    public ObjectFrame(String name, XyzAbcTransformation x) { t = Kin.fromXyzAbc(x == null ? new double[6] : x.array()); }

    public double[][] fromFlange() { return t; }

    public IMotionContainer moveAsync(IMotion m) { return m.start(t); }
}
