package com.kuka.roboticsAPI.geometricModel;

import com.kuka.roboticsAPI.geometricModel.math.XyzAbcTransformation;
import kstsim.SimRobot;

public class Tool {
    private ObjectFrame motionFrame = new ObjectFrame("root", null);

    private final LoadData load;

    public Tool(String name, LoadData load) { this.load = load; }

    public LoadData getLoadData() { return load; }

    public ObjectFrame addChildFrame(String name, XyzAbcTransformation t) { return new ObjectFrame(name, t); }

    public void setDefaultMotionFrame(ObjectFrame f) { motionFrame = f; }

    public ObjectFrame getDefaultMotionFrame() { return motionFrame; }

    public void attachTo(ObjectFrame f) { SimRobot.note("attach " + load); }

    public void detach() { }
}
