package com.kuka.roboticsAPI.geometricModel;

public class LoadData {
    private double mass;
    private double[] centre = new double[3];

    public void setMass(double kg) {
        if (!(kg >= 0)) throw new IllegalArgumentException("mass " + kg + " is negative");
        mass = kg;
    }

    public double getMass() { return mass; }

    public void setCenterOfMass(double x, double y, double z) { centre = new double[] {x, y, z}; }

    @Override
    public String toString() { return mass + " kg at " + java.util.Arrays.toString(centre); }
}
