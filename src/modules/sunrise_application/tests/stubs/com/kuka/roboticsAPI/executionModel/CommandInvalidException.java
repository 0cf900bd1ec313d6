package com.kuka.roboticsAPI.executionModel;

public class CommandInvalidException extends RuntimeException {
    private static final long serialVersionUID = 1;

    public CommandInvalidException(String message) { super(message); }
}
